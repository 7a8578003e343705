/* spivcal for C++14 and newer: handles that destroy themselves, errors as exceptions, results as std::vector and std::string.

   Header-only; everything goes through spivcal.h, which says what the functions do, their units and frames.

     spivcal::Context context;
     spivcal::Rig rig = context.load_rig("rig.toml");
     spivcal::Calibration c = rig.calibrate();
     spivcal::Number d = c.number(SPIVCAL_SHEET_DISTANCE_MM);      // d.value, d.sigma
     std::vector<double> x, y;
     c.sheet_from_pixel(0, u, v, x, y);

   Objects can be moved, not copied. A context must outlive what was made in it; an object whose context is gone gives errors.
   An object may be used by several threads where the table in spivcal.h says so. */

#ifndef SPIVCAL_HPP
#define SPIVCAL_HPP

#include "spivcal.h"

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace spivcal {

/* A call that failed: its status (SPIVCAL_ERROR_*) and, as what(), the error text. */
class Error : public std::runtime_error {
public:
    Error(std::int32_t status, const std::string &text) : std::runtime_error(text), status_(status) {}
    std::int32_t status() const noexcept { return status_; }

private:
    std::int32_t status_;
};

/* A number with its standard deviation: 0 where it was held, NaN where it is unknown. */
struct Number {
    double value;
    double sigma;
};

namespace detail {

/* Asks for the size, then copies; again where another thread has made it more in between. */
template <class T, class Copy> std::int32_t copied(Copy copy, std::vector<T> &out) {
    std::uint64_t needed = 0;
    std::int32_t status = copy(static_cast<T *>(nullptr), std::uint64_t(0), &needed);
    do {
        out.resize(static_cast<std::size_t>(needed));
        if (status < 0 || needed == 0) return status;
        status = copy(out.data(), static_cast<std::uint64_t>(out.size()), &needed);
    } while (status == SPIVCAL_ERROR_BUFFER_TOO_SMALL);
    if (status >= 0) out.resize(static_cast<std::size_t>(needed));
    return status;
}

template <class Copy> std::int32_t text(Copy copy, std::string &out) {
    std::vector<char> buffer;
    std::int32_t status = copied(copy, buffer);
    if (status >= 0 && !buffer.empty()) out.assign(buffer.data());
    return status;
}

/* The error text of `handle`, or the meaning of the status where the handle has none. */
inline void check(std::int32_t status, std::uint64_t handle) {
    if (status >= 0) return;
    std::string words;
    text([&](char *b, std::uint64_t n, std::uint64_t *m) { return spivcal_error_text(handle, b, n, m); }, words);
    if (words.empty())
        text([&](char *b, std::uint64_t n, std::uint64_t *m) { return spivcal_status_text(status, b, n, m); }, words);
    throw Error(status, words);
}

template <class Copy> std::string text_of(std::uint64_t handle, Copy copy) {
    std::string out;
    check(text(copy, out), handle);
    return out;
}

template <class Copy> std::vector<double> array_of(std::uint64_t handle, Copy copy) {
    std::vector<double> out;
    check(copied(copy, out), handle);
    return out;
}

inline std::uint64_t same_size(std::size_t a, std::size_t b, std::size_t c) {
    if (a != b || a != c) throw Error(SPIVCAL_ERROR_ARGUMENT, "the arrays of coordinates have different lengths");
    return static_cast<std::uint64_t>(a);
}

/* A handle that destroys its object. */
template <std::int32_t (*destroy)(std::uint64_t)> class Owner {
public:
    explicit Owner(std::uint64_t handle) noexcept : handle_(handle) {}
    Owner(Owner &&other) noexcept : handle_(other.release()) {}
    Owner &operator=(Owner &&other) noexcept {
        if (this != &other) {
            reset();
            handle_ = other.release();
        }
        return *this;
    }
    Owner(const Owner &) = delete;
    Owner &operator=(const Owner &) = delete;
    ~Owner() { reset(); }

    /* The handle, for calls of spivcal.h. */
    std::uint64_t handle() const noexcept { return handle_; }
    /* Gives the handle away: the caller destroys it. */
    std::uint64_t release() noexcept {
        std::uint64_t h = handle_;
        handle_ = 0;
        return h;
    }

protected:
    void must(std::int32_t status) const { check(status, handle_); }

private:
    void reset() noexcept {
        if (handle_ != 0) destroy(handle_);
        handle_ = 0;
    }
    std::uint64_t handle_;
};

} // namespace detail

/* Version of the library, such as "0.1.0". */
inline std::string version() {
    return detail::text_of(0, [](char *b, std::uint64_t n, std::uint64_t *m) { return spivcal_version_copy(b, n, m); });
}

class Image : public detail::Owner<&spivcal_image_destroy> {
public:
    using Owner::Owner;
    std::uint32_t width() const { return size().first; }
    std::uint32_t height() const { return size().second; }

private:
    std::pair<std::uint32_t, std::uint32_t> size() const {
        std::pair<std::uint32_t, std::uint32_t> s(0, 0);
        must(spivcal_image_size(handle(), &s.first, &s.second));
        return s;
    }
};

/* Discs in one image. */
class Detection : public detail::Owner<&spivcal_detection_destroy> {
public:
    using Owner::Owner;
    void set(std::int32_t key, double value) { must(spivcal_detection_set_number(handle(), key, value)); }
    void unset(std::int32_t key) { must(spivcal_detection_unset(handle(), key)); }
    void run(const Image &image) { must(spivcal_detection_run(handle(), image.handle())); }
    std::uint64_t count(std::int32_t key = SPIVCAL_COUNT_DISCS) const {
        std::uint64_t n = 0;
        must(spivcal_detection_count(handle(), key, &n));
        return n;
    }
    std::vector<double> array(std::int32_t key, std::uint64_t disc = 0) const {
        const std::uint64_t h = handle();
        return detail::array_of(h, [=](double *b, std::uint64_t n, std::uint64_t *m) {
            return spivcal_detection_array_copy(h, key, disc, b, n, m);
        });
    }
    std::string text(std::int32_t key, std::uint64_t index = 0) const {
        const std::uint64_t h = handle();
        return detail::text_of(h, [=](char *b, std::uint64_t n, std::uint64_t *m) {
            return spivcal_detection_text_copy(h, key, index, nullptr, b, n, m);
        });
    }
};

/* A grid of the sheet: pixel (i, j), column and row from 0, is centred on (x0_mm + mm_per_px i, y0_mm - mm_per_px j). */
struct SheetGrid {
    double x0_mm;
    double y0_mm;
    double mm_per_px;
    std::uint32_t width;
    std::uint32_t height;
};

/* Three components of displacement and what is known of them: see spivcal_calibration_components. */
struct Components {
    std::vector<double> u_mm, v_mm, w_mm, residual_mm, sigma_u, sigma_v, sigma_w;
};

class Calibration : public detail::Owner<&spivcal_calibration_destroy> {
public:
    explicit Calibration(std::uint64_t handle, bool flagged = false) noexcept : Owner(handle), flagged_(flagged) {}
    /* Whether it must be looked at before it is used (SPIVCAL_TEXT_HEADLINE, SPIVCAL_TEXT_FLAG, SPIVCAL_TEXT_UNDETERMINED), also where
       it was loaded. */
    bool flagged() const noexcept { return flagged_; }

    std::uint64_t count(std::int32_t key) const {
        std::uint64_t n = 0;
        must(spivcal_calibration_count(handle(), key, &n));
        return n;
    }
    bool has_sheet() const { return count(SPIVCAL_COUNT_SHEETS) > 0; }
    Number number(std::int32_t key, std::uint64_t index = 0) const {
        Number n = {0.0, 0.0};
        must(spivcal_calibration_number(handle(), key, index, &n.value, &n.sigma));
        return n;
    }
    std::vector<double> array(std::int32_t key, std::uint64_t index = 0) const {
        const std::uint64_t h = handle();
        return detail::array_of(h, [=](double *b, std::uint64_t n, std::uint64_t *m) {
            return spivcal_calibration_array_copy(h, key, index, b, n, m);
        });
    }
    std::string text(std::int32_t key, std::uint64_t index = 0) const {
        const std::uint64_t h = handle();
        return detail::text_of(h, [=](char *b, std::uint64_t n, std::uint64_t *m) {
            return spivcal_calibration_text_copy(h, key, index, b, n, m);
        });
    }
    void save(const std::string &path_utf8) const { must(spivcal_calibration_save(handle(), path_utf8.c_str())); }

    /* The mapping functions resize their results; false where some points have none (NaN there). */
    bool project(std::uint64_t camera, const std::vector<double> &x_mm, const std::vector<double> &y_mm,
                 const std::vector<double> &z_mm, std::vector<double> &u_px, std::vector<double> &v_px,
                 std::vector<std::int32_t> *point_status = nullptr) const {
        const std::uint64_t n = detail::same_size(x_mm.size(), y_mm.size(), z_mm.size());
        resize(x_mm.size(), {&u_px, &v_px}, point_status);
        return all(spivcal_calibration_project(handle(), camera, n, x_mm.data(), y_mm.data(), z_mm.data(), u_px.data(),
                                               v_px.data(), data(point_status)));
    }
    bool unproject(std::uint64_t camera, const std::vector<double> &u_px, const std::vector<double> &v_px,
                   std::vector<double> &dx, std::vector<double> &dy, std::vector<double> &dz,
                   std::vector<std::int32_t> *point_status = nullptr) const {
        const std::uint64_t n = detail::same_size(u_px.size(), v_px.size(), v_px.size());
        resize(u_px.size(), {&dx, &dy, &dz}, point_status);
        return all(spivcal_calibration_unproject(handle(), camera, n, u_px.data(), v_px.data(), dx.data(), dy.data(),
                                                 dz.data(), data(point_status)));
    }
    /* Lines of sight, behind a window those in the water: points (mm) and unit directions in the rig frame. */
    bool sight_from_pixel(std::uint64_t camera, const std::vector<double> &u_px, const std::vector<double> &v_px,
                          std::vector<double> &x_mm, std::vector<double> &y_mm, std::vector<double> &z_mm,
                          std::vector<double> &dx, std::vector<double> &dy, std::vector<double> &dz,
                          std::vector<std::int32_t> *point_status = nullptr) const {
        const std::uint64_t n = detail::same_size(u_px.size(), v_px.size(), v_px.size());
        resize(u_px.size(), {&x_mm, &y_mm, &z_mm, &dx, &dy, &dz}, point_status);
        return all(spivcal_calibration_sight_from_pixel(handle(), camera, n, u_px.data(), v_px.data(), x_mm.data(),
                                                        y_mm.data(), z_mm.data(), dx.data(), dy.data(), dz.data(),
                                                        data(point_status)));
    }
    bool sheet_from_pixel(std::uint64_t camera, const std::vector<double> &u_px, const std::vector<double> &v_px,
                          std::vector<double> &x_mm, std::vector<double> &y_mm,
                          std::vector<std::int32_t> *point_status = nullptr) const {
        const std::uint64_t n = detail::same_size(u_px.size(), v_px.size(), v_px.size());
        resize(u_px.size(), {&x_mm, &y_mm}, point_status);
        return all(spivcal_calibration_sheet_from_pixel(handle(), camera, n, u_px.data(), v_px.data(), x_mm.data(),
                                                        y_mm.data(), data(point_status)));
    }
    bool pixel_from_sheet(std::uint64_t camera, const std::vector<double> &x_mm, const std::vector<double> &y_mm,
                          std::vector<double> &u_px, std::vector<double> &v_px,
                          std::vector<std::int32_t> *point_status = nullptr) const {
        const std::uint64_t n = detail::same_size(x_mm.size(), y_mm.size(), y_mm.size());
        resize(x_mm.size(), {&u_px, &v_px}, point_status);
        return all(spivcal_calibration_pixel_from_sheet(handle(), camera, n, x_mm.data(), y_mm.data(), u_px.data(),
                                                        v_px.data(), data(point_status)));
    }

    /* The grid that covers what all cameras see; 0: as fine as the finest of them. */
    SheetGrid sheet_grid(double mm_per_px = 0.0) const {
        SheetGrid g = {0.0, 0.0, 0.0, 0, 0};
        must(spivcal_calibration_sheet_grid(handle(), mm_per_px, &g.x0_mm, &g.y0_mm, &g.mm_per_px, &g.width, &g.height));
        return g;
    }
    /* A dewarped image, rows packed; `seen` (may be null) receives 1 where the camera sees the pixel. */
    std::vector<float> dewarp(std::uint64_t camera, const Image &image, const SheetGrid &grid,
                              std::int32_t kernel = SPIVCAL_KERNEL_BSPLINE, std::vector<std::uint8_t> *seen = nullptr,
                              double z_mm = 0.0) const {
        const std::size_t n = static_cast<std::size_t>(grid.width) * grid.height;
        std::vector<float> grey(n);
        if (seen) seen->resize(n);
        must(spivcal_calibration_dewarp(handle(), camera, image.handle(), kernel, grid.x0_mm, grid.y0_mm, grid.mm_per_px,
                                        z_mm, grid.width, grid.height, grey.data(), seen ? seen->data() : nullptr));
        return grey;
    }
    /* Three components at points of the sheet from what both dewarped images show there; false where some points have none. */
    bool components(const std::vector<double> &x_mm, const std::vector<double> &y_mm, const std::vector<double> &dx1_mm,
                    const std::vector<double> &dy1_mm, const std::vector<double> &dx2_mm,
                    const std::vector<double> &dy2_mm, Components &out,
                    std::vector<std::int32_t> *point_status = nullptr) const {
        detail::same_size(x_mm.size(), y_mm.size(), dx1_mm.size());
        detail::same_size(x_mm.size(), dy1_mm.size(), dx2_mm.size());
        const std::uint64_t n = detail::same_size(x_mm.size(), dy2_mm.size(), dy2_mm.size());
        resize(x_mm.size(), {&out.u_mm, &out.v_mm, &out.w_mm, &out.residual_mm, &out.sigma_u, &out.sigma_v, &out.sigma_w},
               point_status);
        return all(spivcal_calibration_components(
            handle(), n, x_mm.data(), y_mm.data(), dx1_mm.data(), dy1_mm.data(), dx2_mm.data(), dy2_mm.data(),
            out.u_mm.data(), out.v_mm.data(), out.w_mm.data(), out.residual_mm.data(), out.sigma_u.data(),
            out.sigma_v.data(), out.sigma_w.data(), data(point_status)));
    }

private:
    static std::int32_t *data(std::vector<std::int32_t> *status) { return status ? status->data() : nullptr; }
    static void resize(std::size_t n, std::initializer_list<std::vector<double> *> arrays,
                       std::vector<std::int32_t> *status) {
        for (std::vector<double> *a : arrays) a->resize(n);
        if (status) status->resize(n);
    }
    bool all(std::int32_t status) const {
        must(status);
        return status != SPIVCAL_WARNING_POINTS;
    }
    bool flagged_;
};

/* How far a job is. */
struct Progress {
    std::int32_t state;
    std::uint64_t images_done;
    std::uint64_t images;
    std::uint64_t iteration;
    double decrement;
};

/* A calibration that runs in a thread of its own; destroying it stops it. */
class Job : public detail::Owner<&spivcal_job_destroy> {
public:
    using Owner::Owner;
    Progress poll() const {
        Progress p = {0, 0, 0, 0, 0.0};
        must(spivcal_job_poll(handle(), &p.state, &p.images_done, &p.images, &p.iteration, &p.decrement));
        return p;
    }
    /* SPIVCAL_JOB_* after at most `timeout_ms`; negative: as long as it takes. */
    std::int32_t wait(std::int32_t timeout_ms = -1) const {
        std::int32_t state = 0;
        must(spivcal_job_wait(handle(), timeout_ms, &state));
        return state;
    }
    void cancel() { must(spivcal_job_cancel(handle())); }
    Calibration result() const {
        std::uint64_t c = 0;
        const std::int32_t status = spivcal_job_result(handle(), &c);
        must(status);
        return Calibration(c, status == SPIVCAL_WARNING_FLAGGED);
    }
};

/* What is to be calibrated. */
class Rig : public detail::Owner<&spivcal_rig_destroy> {
public:
    using Owner::Owner;
    std::uint64_t add_camera(const std::string &name_utf8) {
        std::uint64_t c = 0;
        must(spivcal_rig_add_camera(handle(), name_utf8.c_str(), &c));
        return c;
    }
    std::uint64_t add_view() {
        std::uint64_t v = 0;
        must(spivcal_rig_add_view(handle(), &v));
        return v;
    }
    void add_mark(const std::string &kind, std::int32_t column, std::int32_t row, std::int32_t level = 0) {
        must(spivcal_rig_add_mark(handle(), kind.c_str(), column, row, level));
    }
    void set(std::int32_t key, double value, std::uint64_t index = 0) {
        must(spivcal_rig_set_number(handle(), key, index, value));
    }
    void set(std::int32_t key, const std::string &text_utf8, std::uint64_t index = 0) {
        must(spivcal_rig_set_text(handle(), key, index, text_utf8.c_str()));
    }
    void unset(std::int32_t key, std::uint64_t index = 0) { must(spivcal_rig_unset(handle(), key, index)); }
    void set_known(std::uint64_t camera, std::int32_t parameter, double value, double sigma) {
        must(spivcal_rig_set_known(handle(), camera, parameter, value, sigma));
    }
    void unset_known(std::uint64_t camera, std::int32_t parameter) {
        must(spivcal_rig_unset_known(handle(), camera, parameter));
    }
    void set_scale(std::int32_t fact, std::uint64_t view, std::uint64_t disc, double value_mm, double sigma_mm) {
        must(spivcal_rig_set_scale(handle(), fact, view, disc, value_mm, sigma_mm));
    }
    void unset_scale() { must(spivcal_rig_unset_scale(handle())); }
    void remove_marks() { must(spivcal_rig_remove_marks(handle())); }
    /* Views after it are counted one less from then on. */
    void remove_view(std::uint64_t view) { must(spivcal_rig_remove_view(handle(), view)); }
    void set_image(std::uint64_t view, std::uint64_t camera, const Image &image) {
        must(spivcal_rig_set_image(handle(), view, camera, image.handle()));
    }
    void set_image_file(std::uint64_t view, std::uint64_t camera, const std::string &path_utf8) {
        must(spivcal_rig_set_image_file(handle(), view, camera, path_utf8.c_str()));
    }
    void unset_image(std::uint64_t view, std::uint64_t camera) {
        must(spivcal_rig_unset_image(handle(), view, camera));
    }
    void check() const { must(spivcal_rig_check(handle())); }
    std::string text() const {
        const std::uint64_t h = handle();
        return detail::text_of(
            h, [=](char *b, std::uint64_t n, std::uint64_t *m) { return spivcal_rig_text_copy(h, b, n, m); });
    }
    /* Blocks until it is done. */
    Calibration calibrate() const {
        std::uint64_t c = 0;
        const std::int32_t status = spivcal_calibration_run(handle(), &c);
        must(status);
        return Calibration(c, status == SPIVCAL_WARNING_FLAGGED);
    }
    Calibration find_sheet(const Calibration &cameras) const {
        std::uint64_t c = 0;
        const std::int32_t status = spivcal_calibration_run_sheet(handle(), cameras.handle(), &c);
        must(status);
        return Calibration(c, status == SPIVCAL_WARNING_FLAGGED);
    }
    Job start() const {
        std::uint64_t j = 0;
        must(spivcal_job_start(handle(), &j));
        return Job(j);
    }
    Job start_sheet(const Calibration &cameras) const {
        std::uint64_t j = 0;
        must(spivcal_job_start_sheet(handle(), cameras.handle(), &j));
        return Job(j);
    }
};

class Context : public detail::Owner<&spivcal_context_destroy> {
public:
    /* `threads`: 0 takes as many as the machine has. */
    explicit Context(std::int32_t threads = 0) : Owner(create(threads)) {}

    Rig new_rig() const { return make<Rig>([](std::uint64_t c, std::uint64_t *o) { return spivcal_rig_create(c, o); }); }
    Rig parse_rig(const std::string &toml_utf8, const std::string &images_dir_utf8 = std::string()) const {
        return make<Rig>([&](std::uint64_t c, std::uint64_t *o) {
            return spivcal_rig_parse(c, toml_utf8.c_str(), images_dir_utf8.c_str(), o);
        });
    }
    Rig load_rig(const std::string &path_utf8, const std::string &images_dir_utf8 = std::string()) const {
        return make<Rig>([&](std::uint64_t c, std::uint64_t *o) {
            return spivcal_rig_load(c, path_utf8.c_str(), images_dir_utf8.c_str(), o);
        });
    }
    Image load_image(const std::string &path_utf8) const {
        return make<Image>([&](std::uint64_t c, std::uint64_t *o) { return spivcal_image_load(c, path_utf8.c_str(), o); });
    }
    /* `stride_bytes` 0: rows follow each other without gap. */
    Image image(const std::uint8_t *data, std::uint32_t width, std::uint32_t height, std::uint64_t stride_bytes = 0) const {
        const std::uint64_t stride = stride_bytes ? stride_bytes : std::uint64_t(width);
        return make<Image>([&](std::uint64_t c, std::uint64_t *o) {
            return spivcal_image_create_u8(c, data, width, height, stride, o);
        });
    }
    Image image(const std::uint16_t *data, std::uint32_t width, std::uint32_t height, std::uint64_t stride_bytes = 0) const {
        const std::uint64_t stride = stride_bytes ? stride_bytes : 2 * std::uint64_t(width);
        return make<Image>([&](std::uint64_t c, std::uint64_t *o) {
            return spivcal_image_create_u16(c, data, width, height, stride, o);
        });
    }
    Image image(const float *data, std::uint32_t width, std::uint32_t height, std::uint64_t stride_bytes = 0) const {
        const std::uint64_t stride = stride_bytes ? stride_bytes : 4 * std::uint64_t(width);
        return make<Image>([&](std::uint64_t c, std::uint64_t *o) {
            return spivcal_image_create_f32(c, data, width, height, stride, o);
        });
    }
    Detection new_detection() const {
        return make<Detection>([](std::uint64_t c, std::uint64_t *o) { return spivcal_detection_create(c, o); });
    }
    Calibration load_calibration(const std::string &path_utf8) const {
        return judged([&](std::uint64_t c, std::uint64_t *o) { return spivcal_calibration_load(c, path_utf8.c_str(), o); });
    }
    Calibration parse_calibration(const std::string &json_utf8) const {
        return judged([&](std::uint64_t c, std::uint64_t *o) { return spivcal_calibration_parse(c, json_utf8.c_str(), o); });
    }

private:
    static std::uint64_t create(std::int32_t threads) {
        if (spivcal_abi_version() != SPIVCAL_ABI_VERSION)
            throw Error(SPIVCAL_ERROR_ARGUMENT, "the header and the library of spivcal have different interface versions");
        std::uint64_t h = 0;
        detail::check(spivcal_context_create(threads, &h), 0);
        return h;
    }
    template <class T, class Call> T make(Call call) const {
        std::uint64_t h = 0;
        must(call(handle(), &h));
        return T(h);
    }
    /* Reading is no warning: whether the calibration is flagged stands in it. */
    template <class Call> Calibration judged(Call call) const {
        Calibration c = make<Calibration>(call);
        const bool flagged = c.number(SPIVCAL_FIT_VERDICT).value > 0.0;
        return Calibration(c.release(), flagged);
    }
};

} // namespace spivcal

#endif /* SPIVCAL_HPP */
