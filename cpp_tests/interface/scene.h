/* Small pictures for the tests of the interface: two discs on a ground, drawn with soft edges. */
#ifndef SCENE_H
#define SCENE_H

#include <stdint.h>

/* Part of a pixel at (u, v) inside the ellipse, with an edge about one pixel wide. */
static double scene_inside(double u, double v, double cu, double cv, double a, double b) {
    double x = (u - cu) / a, y = (v - cv) / b, f = x * x + y * y - 1.0;
    double gx = 2.0 * x / a, gy = 2.0 * y / b, g2 = gx * gx + gy * gy, g = 1e-9, d;
    int i;
    if (g2 > 0) {
        g = g2 < 1 ? 1 : g2;
        for (i = 0; i < 30; i++) g = 0.5 * (g + g2 / g);
    }
    d = f / (g < 1e-9 ? 1e-9 : g);
    if (d > 1) return 0;
    if (d < -1) return 1;
    return 0.5 - 0.75 * d + 0.25 * d * d * d;
}

static double scene_grey(int u, int v, int width, int height) {
    double one = scene_inside(u, v, 0.31 * width, 0.52 * height, 0.13 * width, 0.15 * width);
    double two = scene_inside(u, v, 0.68 * width, 0.47 * height, 0.10 * width, 0.12 * width);
    /* A pattern instead of noise, so that nothing is exactly flat. */
    return 40.0 + 150.0 * (one + two) + (double)((u * 7 + v * 13) % 5);
}

static void scene_u8(uint8_t *to, int width, int height, int stride) {
    int u, v;
    for (v = 0; v < height; v++)
        for (u = 0; u < width; u++) to[v * stride + u] = (uint8_t)(scene_grey(u, v, width, height) + 0.5);
}

#endif
