// Hosts with many threads: objects shared, made, used and destroyed at once; and results that do not depend on the thread count.
// Usage: concurrent CALIBRATION.json [RIG.toml]      (with a rig: calibrates it with 1 and with 3 threads)

#include "spivcal.hpp"

extern "C" {
#include "check.h"
#include "scene.h"
}

#include <atomic>
#include <cmath>
#include <cstring>
#include <fstream>
#include <sstream>
#include <thread>

namespace {

std::string read(const std::string &path) {
    std::ifstream file(path, std::ios::binary);
    std::ostringstream text;
    text << file.rdbuf();
    return text.str();
}

bool same_bits(const std::vector<double> &a, const std::vector<double> &b) {
    return a.size() == b.size() && std::memcmp(a.data(), b.data(), 8 * a.size()) == 0;
}

// Eight threads map through one calibration and read it, another loads and destroys its own all the while.
void shared_calibration(const std::string &json) {
    const spivcal::Context context(1);
    const spivcal::Calibration c = context.parse_calibration(json);
    std::vector<double> u, v, x0, y0;
    for (int i = 0; i < 2000; i++) {
        u.push_back(0.5 * i);
        v.push_back(0.3 * i);
    }
    c.sheet_from_pixel(0, u, v, x0, y0);
    std::atomic<int> wrong(0);
    std::vector<std::thread> threads;
    for (int t = 0; t < 8; t++)
        threads.emplace_back([&, t] {
            for (int i = 0; i < 20; i++) {
                std::vector<double> x, y;
                c.sheet_from_pixel(0, u, v, x, y);
                if (!same_bits(x, x0) || !same_bits(y, y0)) wrong++;
                if (t % 2 == 0 && !(c.number(SPIVCAL_CAMERA_F_PX, 1).value > 0)) wrong++;
                if (t % 4 == 1) context.parse_calibration(json);
                // Errors of several threads on one object: a status each, and some text.
                double value = 0;
                if (spivcal_calibration_number(c.handle(), -3, 0, &value, nullptr) != SPIVCAL_ERROR_ARGUMENT) wrong++;
            }
        });
    for (std::thread &t : threads) t.join();
    CHECK(wrong == 0);
}

// Everything is destroyed under the feet of those who use it: they get errors or answers, nothing else.
void destroyed_meanwhile(const std::string &json) {
    for (int round = 0; round < 30; round++) {
        std::uint64_t context = 0, calibration = 0;
        CHECK(spivcal_context_create(1, &context) == SPIVCAL_OK);
        CHECK(spivcal_calibration_parse(context, json.c_str(), &calibration) == SPIVCAL_OK);
        std::atomic<int> wrong(0), destroyed(0);
        std::vector<std::thread> threads;
        for (int t = 0; t < 4; t++)
            threads.emplace_back([&] {
                for (int i = 0; i < 50; i++) {
                    double x = 100, y = 100, a = 0, b = 0;
                    const std::int32_t s = spivcal_calibration_sheet_from_pixel(calibration, 0, 1, &x, &y, &a, &b, nullptr);
                    if (s != SPIVCAL_OK && s != SPIVCAL_ERROR_HANDLE) wrong++;
                    std::uint64_t image = 0;
                    std::uint8_t pixels[4] = {0, 0, 0, 0};
                    const std::int32_t m = spivcal_image_create_u8(context, pixels, 2, 2, 2, &image);
                    if (m != SPIVCAL_OK && m != SPIVCAL_ERROR_HANDLE) wrong++;
                }
            });
        for (int t = 0; t < 2; t++)
            threads.emplace_back([&] {
                if (spivcal_context_destroy(context) == SPIVCAL_OK) destroyed++;
            });
        for (std::thread &t : threads) t.join();
        CHECK(wrong == 0 && destroyed == 1);
    }
}

// Each thread is a host of its own: context, detection, result.
void hosts() {
    static std::uint8_t pixels[240 * 160];
    scene_u8(pixels, 240, 160, 240);
    std::vector<std::vector<double>> found(4);
    std::vector<std::thread> threads;
    for (int t = 0; t < 4; t++)
        threads.emplace_back([&, t] {
            const spivcal::Context context(t + 1);
            spivcal::Detection d = context.new_detection();
            for (int i = 0; i < 3; i++) d.run(context.image(pixels, 240, 160));
            found[t] = d.array(SPIVCAL_DISC_U_PX);
            const std::vector<double> more = d.array(SPIVCAL_DISC_COVARIANCE, 1);
            found[t].insert(found[t].end(), more.begin(), more.end());
        });
    for (std::thread &t : threads) t.join();
    CHECK(found[0].size() == 27);
    for (int t = 1; t < 4; t++) CHECK(same_bits(found[0], found[t]));
}

// What a picture drawn here shows is found where it was drawn.
void truth() {
    static std::uint8_t u8[240 * 160 + 160 * 7];
    scene_u8(u8, 240, 160, 247);
    const spivcal::Context context(1);
    spivcal::Detection d = context.new_detection();
    const spivcal::Image image = context.image(u8, 240, 160, 247);
    CHECK(image.width() == 240 && image.height() == 160);
    d.set(SPIVCAL_DETECT_POLARITY, 1);
    d.run(image);
    CHECK(d.count() == 2);
    const std::vector<double> u = d.array(SPIVCAL_DISC_U_PX), v = d.array(SPIVCAL_DISC_V_PX);
    const std::vector<double> a = d.array(SPIVCAL_DISC_SEMI_MAJOR_PX), b = d.array(SPIVCAL_DISC_SEMI_MINOR_PX);
    for (std::size_t i = 0; i < u.size(); i++) {
        const bool first = u[i] < 120;
        CHECK(std::fabs(u[i] - (first ? 0.31 : 0.68) * 240) < 0.1 && std::fabs(v[i] - (first ? 0.52 : 0.47) * 160) < 0.1);
        CHECK(std::fabs(a[i] - (first ? 0.15 : 0.12) * 240) < 0.3 && std::fabs(b[i] - (first ? 0.13 : 0.10) * 240) < 0.3);
        const std::vector<double> c = d.array(SPIVCAL_DISC_COVARIANCE, i), s = d.array(SPIVCAL_DISC_SIGMA_U_PX);
        CHECK(c.size() == 25 && std::fabs(std::sqrt(c[0]) - s[i]) <= 1e-12 * s[i] && std::fabs(c[1] - c[5]) <= 1e-12 * c[0]);
        CHECK(d.array(SPIVCAL_CONTOUR_U_PX, i).size() == d.array(SPIVCAL_CONTOUR_SIGMA_PX, i).size());
    }
    bool thrown = false;
    try {
        d.array(SPIVCAL_CONTOUR_U_PX, 9);
    } catch (const spivcal::Error &e) {
        thrown = e.status() == SPIVCAL_ERROR_INDEX && std::strstr(e.what(), "disc 9") != nullptr;
    }
    CHECK(thrown);
}

void thread_counts(const std::string &rig_file) {
    std::string json[2];
    for (int i = 0; i < 2; i++) {
        const spivcal::Context context(i == 0 ? 1 : 3);
        const spivcal::Rig rig = context.load_rig(rig_file);
        json[i] = rig.calibrate().text(SPIVCAL_TEXT_JSON);
    }
    CHECK(json[0].size() > 1000 && json[0] == json[1]);
}

// Setters describe what the file describes; the description is the file's.
void setters() {
    const spivcal::Context context(1);
    spivcal::Rig rig = context.new_rig();
    rig.add_camera("left");
    rig.add_camera("right");
    for (std::uint64_t c = 0; c < 2; c++) {
        rig.set(SPIVCAL_RIG_CAMERA_PIXEL_PITCH_MM, 0.00625, c);
        rig.set(SPIVCAL_RIG_CAMERA_FOCAL_LENGTH_MM, 50, c);
    }
    rig.set_known(0, SPIVCAL_PARAMETER_ALPHA_DEG, 0.0, 1.0);
    rig.set_known(1, SPIVCAL_PARAMETER_K3, 0.0, 0.0);
    rig.set_known(1, SPIVCAL_PARAMETER_WINDOW_DISTANCE_MM, 300.0, 20.0);
    rig.set_known(1, SPIVCAL_PARAMETER_WINDOW_N_GLASS, 1.49, 0.0);
    rig.set(SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG, 0.5, 1);
    rig.set(SPIVCAL_RIG_TARGET_KIND, std::string("bubbles"));
    rig.set(SPIVCAL_RIG_TARGET_POLARITY, std::string("bright"));
    rig.set(SPIVCAL_RIG_SOLVE_ESTIMATE, std::string("k1 k2"));
    rig.set_scale(SPIVCAL_SCALE_SPACING, 0, 0, 26.0, 0.1);
    for (std::uint64_t v = 0; v < 2; v++) {
        CHECK(rig.add_view() == v);
        rig.set_image_file(v, 0, "left" + std::to_string(v) + ".png");
        rig.set_image_file(v, 1, "right" + std::to_string(v) + ".png");
        rig.set(SPIVCAL_RIG_VIEW_SHEET, v == 1 ? 1.0 : 0.0, v);
    }
    rig.check();
    const std::string text = rig.text();
    CHECK(text.find("kind = \"bubbles\"") != std::string::npos && text.find("sheet = true") != std::string::npos);
    CHECK(text.find("[camera.window]") != std::string::npos && text.find("n_glass = 1.49") != std::string::npos);
    CHECK(text.find("tilt_sigma_deg = 0.5") != std::string::npos && text.find("sigma = 20") != std::string::npos);
    CHECK(context.parse_rig(text).text() == text);
    // Behind a window the focus says nothing: together they are refused.
    spivcal::Rig focused = context.parse_rig(text);
    focused.set(SPIVCAL_RIG_FOCUS_TILT_SIGMA_DEG, 0.3);
    bool refused = false;
    try {
        focused.check();
    } catch (const spivcal::Error &e) {
        refused = e.status() == SPIVCAL_ERROR_INVALID_INPUT && std::strstr(e.what(), "[focus]") != nullptr;
    }
    CHECK(refused);
    // Taken back it has never been said, and the same description is left.
    focused.unset(SPIVCAL_RIG_FOCUS_TILT_SIGMA_DEG);
    focused.check();
    CHECK(focused.text() == text);
    // A live job: another view, which turns out to be of no use.
    const std::uint64_t late = focused.add_view();
    focused.set_image_file(late, 0, "late.png");
    focused.unset_image(late, 0);
    focused.remove_view(late);
    CHECK(focused.text() == text);
    focused.unset_known(1, SPIVCAL_PARAMETER_WINDOW_N_GLASS);
    CHECK(focused.text().find("n_glass") == std::string::npos);
    // A second scale takes the place of the first; a wrong word is refused with what was expected.
    rig.set_scale(SPIVCAL_SCALE_BASELINE, 0, 0, 700.0, 0.0);
    rig.check();
    rig.set(SPIVCAL_RIG_TARGET_KIND, std::string("balloons"));
    bool thrown = false;
    try {
        rig.check();
    } catch (const spivcal::Error &e) {
        thrown = e.status() == SPIVCAL_ERROR_INVALID_INPUT && std::strstr(e.what(), "two-level-plate") != nullptr;
    }
    CHECK(thrown);
}

// A flag is not lost on the way through a file.
void flags_stay(std::string json) {
    const spivcal::Context context(1);
    const spivcal::Calibration c = context.parse_calibration(json);
    CHECK(c.flagged() == (c.number(SPIVCAL_FIT_VERDICT).value > 0));
    const std::string key = "\"flags\": [";
    const std::size_t at = json.find(key) + key.size();
    json.insert(at, json[at] == ']' ? "\"look\"" : "\"look\", ");
    const spivcal::Calibration flagged = context.parse_calibration(json);
    CHECK(flagged.flagged());
}

} // namespace

int main(int argc, char **argv) {
    if (argc < 2) return 2;
    const std::string json = read(argv[1]);
    truth();
    setters();
    flags_stay(json);
    shared_calibration(json);
    destroyed_meanwhile(json);
    hosts();
    if (argc > 2) thread_counts(argv[2]);
    return check_end();
}
