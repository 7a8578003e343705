// Two threads let the library write into one array, which the header forbids: ThreadSanitizer must see the writes of both, or the other
// tests with it say nothing.
// Usage: race_is_seen CALIBRATION.json

#include "spivcal.hpp"

#include <fstream>
#include <sstream>
#include <thread>

int main(int, char **argv) {
    std::ostringstream json;
    json << std::ifstream(argv[1], std::ios::binary).rdbuf();
    const spivcal::Context context(1);
    const spivcal::Calibration c = context.parse_calibration(json.str());
    const std::vector<double> u(1000, 100.0), v(1000, 100.0);
    std::vector<double> x(1000), y(1000);
    auto map = [&] {
        for (int i = 0; i < 100; i++)
            spivcal_calibration_sheet_from_pixel(c.handle(), 0, 1000, u.data(), v.data(), x.data(), y.data(), nullptr);
    };
    std::thread one(map), two(map);
    one.join();
    two.join();
    return 0;
}
