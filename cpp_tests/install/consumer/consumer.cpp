// A project of somebody else.
#include <spivcal.hpp>

#include <iostream>

int main() {
    const spivcal::Context context(1);
    try {
        context.load_rig("no_such_rig.toml");
    } catch (const spivcal::Error &e) {
        std::cout << "spivcal " << spivcal::version() << ": " << e.what() << "\n";
        return e.status() == SPIVCAL_ERROR_INVALID_INPUT ? 0 : 1;
    }
    return 1;
}
