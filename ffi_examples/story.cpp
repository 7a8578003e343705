// The story in C++14: two images per view, calibrate in the background, print sheet and sigmas, map points.
// Usage: story_cpp RIG.toml IMAGE_DIR SAVED.json

#include "spivcal.hpp"

#include <cmath>
#include <cstdio>
#include <iostream>

namespace {

void print(const spivcal::Calibration &c, const char *name, std::int32_t key, std::uint64_t index = 0) {
    const spivcal::Number n = c.number(key, index);
    std::printf("%s %.17g %.17g\n", name, n.value, n.sigma);
}

int story(const std::string &rig_file, const std::string &images, const std::string &saved) {
    const spivcal::Context context;
    spivcal::Rig rig = context.load_rig(rig_file, images);
    // Two images come from memory instead of from their files, as a camera would deliver them.
    rig.set_image(0, 0, context.load_image(images + "/v01_left.png"));
    rig.set_image(0, 1, context.load_image(images + "/v01_right.png"));

    const spivcal::Job job = rig.start();
    while (job.wait(200) == SPIVCAL_JOB_RUNNING) {
        const spivcal::Progress p = job.poll();
        std::cerr << p.images_done << " of " << p.images << " images, iteration " << p.iteration << "\n";
    }
    const spivcal::Calibration c = job.result();
    std::cerr << c.text(SPIVCAL_TEXT_HEADLINE) << "\n";
    std::printf("flagged %d\n", c.flagged() ? 1 : 0);
    for (std::uint64_t camera = 0; camera < c.count(SPIVCAL_COUNT_CAMERAS); camera++) {
        print(c, "f_px", SPIVCAL_CAMERA_F_PX, camera);
        print(c, "beta_rad", SPIVCAL_CAMERA_BETA_RAD, camera);
    }
    print(c, "baseline_mm", SPIVCAL_BASELINE_MM);
    print(c, "distance_mm", SPIVCAL_SHEET_DISTANCE_MM);
    print(c, "a_per_mm", SPIVCAL_SHEET_A_PER_MM);
    print(c, "b_per_mm", SPIVCAL_SHEET_B_PER_MM);
    print(c, "c_per_mm", SPIVCAL_SHEET_C_PER_MM);
    print(c, "angle_to_baseline_deg", SPIVCAL_SHEET_ANGLE_TO_BASELINE_DEG);

    c.save(saved);
    const spivcal::Calibration again = context.load_calibration(saved);
    if (again.flagged() != c.flagged()) return 1;
    const std::vector<double> u = {100.0, 511.5, 900.0}, v = {80.0, 383.5, 700.0};
    std::vector<double> x, y, u_back, v_back;
    if (!again.sheet_from_pixel(0, u, v, x, y) || !again.pixel_from_sheet(0, x, y, u_back, v_back)) return 1;
    for (std::size_t i = 0; i < u.size(); i++) {
        std::printf("map %.17g %.17g\n", x[i], y[i]);
        if (!(std::hypot(u_back[i] - u[i], v_back[i] - v[i]) < 1e-8)) return 1;
    }
    return 0;
}

} // namespace

int main(int argc, char **argv) {
    if (argc != 4) {
        std::cerr << "usage: " << argv[0] << " RIG.toml IMAGE_DIR SAVED.json\n";
        return 2;
    }
    try {
        return story(argv[1], argv[2], argv[3]);
    } catch (const spivcal::Error &e) {
        std::cerr << e.what() << " (status " << e.status() << ")\n";
        return 1;
    }
}
