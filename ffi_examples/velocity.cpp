// From a calibration to three components of velocity, in C++14: a grid in the sheet, dewarped images, and vectors.
//   velocity CALIBRATION.json LEFT_IMAGE RIGHT_IMAGE
// Between the second and the third step a host correlates its own exposures; here particles on known paths stand for them, so that the
// result can be checked.
#include <spivcal.hpp>

#include <cmath>
#include <cstdio>
#include <exception>
#include <iostream>
#include <vector>

namespace {

typedef std::vector<double> List;

// Points of the sheet frame in that of the rig.
void to_rig(const List &rig_from_sheet, const List &x, const List &y, const List &z, List *out) {
    for (std::size_t k = 0; k < 3; k++) {
        out[k].resize(x.size());
        const double *row = &rig_from_sheet[4 * k];
        for (std::size_t i = 0; i < x.size(); i++) out[k][i] = row[0] * x[i] + row[1] * y[i] + row[2] * z[i] + row[3];
    }
}

int velocity(const char *json, const char *left, const char *right) {
    const spivcal::Context context;
    const spivcal::Calibration c = context.load_calibration(json);

    // 1. A grid that both cameras see, here with pixels four times as large as the finest.
    const spivcal::SheetGrid finest = c.sheet_grid();
    const spivcal::SheetGrid grid = c.sheet_grid(4.0 * finest.mm_per_px);
    std::printf("grid %u x %u px of %.4f mm, first pixel at (%.3f, %.3f) mm\n", grid.width, grid.height, grid.mm_per_px,
                grid.x0_mm, grid.y0_mm);

    // 2. Both images on it.
    const char *files[2] = {left, right};
    for (std::uint64_t camera = 0; camera < 2; camera++) {
        std::vector<std::uint8_t> seen;
        const std::vector<float> grey = c.dewarp(camera, context.load_image(files[camera]), grid, SPIVCAL_KERNEL_BSPLINE, &seen);
        double sum = 0.0, count = 0.0;
        for (std::size_t i = 0; i < grey.size(); i++) sum += seen[i] ? grey[i] : 0.0, count += seen[i];
        std::printf("camera %u: sees %.0f %% of the grid, mean grey level %.1f\n", static_cast<unsigned>(camera),
                    100.0 * count / static_cast<double>(grey.size()), sum / count);
        if (!(count > 0.5 * static_cast<double>(grey.size()))) return 1;
    }

    // 3. Vectors. d: what both dewarped images show of particles that move by (u, v, w) about points of the sheet.
    const double u = 0.20, v = -0.10, w = 0.35;
    const List pose = c.array(SPIVCAL_ARRAY_RIG_FROM_SHEET);
    List x, y, d[2][2];
    for (int j = 1; j < 8; j++)
        for (int i = 1; i < 10; i++) {
            x.push_back(grid.x0_mm + 0.1 * i * (grid.width - 1) * grid.mm_per_px);
            y.push_back(grid.y0_mm - 0.125 * j * (grid.height - 1) * grid.mm_per_px);
        }
    for (int camera = 0; camera < 2; camera++)
        for (int end = 0; end < 2; end++) {
            const double half = end ? 0.5 : -0.5;
            List px(x), py(y), pz(x.size(), half * w), rig[3], q[2], hit[2];
            for (std::size_t i = 0; i < x.size(); i++) px[i] += half * u, py[i] += half * v;
            to_rig(pose, px, py, pz, rig);
            if (!c.project(camera, rig[0], rig[1], rig[2], q[0], q[1]) ||
                !c.sheet_from_pixel(camera, q[0], q[1], hit[0], hit[1]))
                return 1;
            for (int axis = 0; axis < 2; axis++) {
                d[camera][axis].resize(x.size());
                for (std::size_t i = 0; i < x.size(); i++) d[camera][axis][i] += (end ? 1.0 : -1.0) * hit[axis][i];
            }
        }
    spivcal::Components found;
    if (!c.components(x, y, d[0][0], d[0][1], d[1][0], d[1][1], found)) return 1;
    double worst = 0.0;
    for (std::size_t i = 0; i < x.size(); i++)
        worst = std::fmax(worst, std::hypot(std::hypot(found.u_mm[i] - u, found.v_mm[i] - v), found.w_mm[i] - w));
    std::printf("%u vectors of (%.2f, %.2f, %.2f) mm: off by at most %.1e mm; sigma of w %.2f times that of a planar component\n",
                static_cast<unsigned>(x.size()), u, v, w, worst, found.sigma_w[x.size() / 2]);
    return worst < 1e-6 ? 0 : 1;
}

} // namespace

int main(int argc, char **argv) {
    if (argc != 4) {
        std::cerr << "usage: " << argv[0] << " CALIBRATION.json LEFT_IMAGE RIGHT_IMAGE\n";
        return 2;
    }
    try {
        return velocity(argv[1], argv[2], argv[3]);
    } catch (const spivcal::Error &e) {
        std::cerr << e.what() << " (status " << e.status() << ")\n";
        return 1;
    }
}
