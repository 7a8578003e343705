/* A host that loads and unloads the library again and again, with work in threads: nothing of it may stay behind.
   Usage: reload LIBRARY */

#define _POSIX_C_SOURCE 200809L
#include "check.h"
#include "scene.h"

#include <dirent.h>
#include <dlfcn.h>
#include <pthread.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef int32_t (*create_t)(int32_t, uint64_t *);
typedef int32_t (*destroy_t)(uint64_t);
typedef int32_t (*image_t)(uint64_t, const uint8_t *, uint32_t, uint32_t, uint64_t, uint64_t *);
typedef int32_t (*make_t)(uint64_t, uint64_t *);
typedef int32_t (*run_t)(uint64_t, uint64_t);
typedef int32_t (*parse_t)(uint64_t, const char *, const char *, uint64_t *);
typedef int32_t (*set_image_t)(uint64_t, uint64_t, uint64_t, uint64_t);

static int threads_now(void) {
    DIR *dir = opendir("/proc/self/task");
    struct dirent *entry;
    int count = 0;
    if (!dir) return 1;
    while ((entry = readdir(dir)) != NULL) count += entry->d_name[0] != '.';
    closedir(dir);
    return count;
}

/* ISO C has no conversion from an object pointer to a function pointer. */
static void get(void *library, const char *name, void *function) {
    void *found = dlsym(library, name);
    CHECK(found != NULL);
    memcpy(function, &found, sizeof found);
}

static const char RIG[] = "[[camera]]\nname = \"left\"\n[[camera]]\nname = \"right\"\n[target]\nkind = \"two-discs\"\n"
                          "spacing_mm = 26.0\n[[view]]\nleft = \"a\"\nright = \"b\"\n[[view]]\nleft = \"c\"\nright = \"d\"\n";

static uint8_t pixels[240 * 160];

/* What a host does between loading and unloading. */
static void *use(void *library) {
    create_t create;
    destroy_t destroy;
    image_t image_create;
    make_t detection_create, job_start;
    run_t detection_run;
    parse_t rig_parse;
    set_image_t set_image;
    uint64_t context = 0, image = 0, detection = 0, rig = 0, job = 0, v;
    static uint8_t own[sizeof pixels];
    const int before = threads_now();
    get(library, "spivcal_context_create", &create);
    get(library, "spivcal_context_destroy", &destroy);
    get(library, "spivcal_image_create_u8", &image_create);
    get(library, "spivcal_detection_create", &detection_create);
    get(library, "spivcal_detection_run", &detection_run);
    get(library, "spivcal_rig_parse", &rig_parse);
    get(library, "spivcal_rig_set_image", &set_image);
    get(library, "spivcal_job_start", &job_start);
    if (check_failures) return NULL;
    memcpy(own, pixels, sizeof own);
    CHECK(create(3, &context) == 0);
    CHECK(image_create(context, pixels, 240, 160, 240, &image) == 0);
    CHECK(detection_create(context, &detection) == 0);
    CHECK(detection_run(detection, image) == 0);
    CHECK(threads_now() == before);
    CHECK(rig_parse(context, RIG, "", &rig) == 0);
    for (v = 0; v < 4; v++) {
        /* A picture that came before would be refused. */
        own[v] ^= 1;
        CHECK(image_create(context, own, 240, 160, 240, &image) == 0);
        CHECK(set_image(rig, v / 2, v % 2, image) == 0);
    }
    /* The job is under way when its context goes. */
    CHECK(job_start(rig, &job) == 0);
    CHECK(destroy(context) == 0);
    CHECK(threads_now() == before);
    return NULL;
}

int main(int argc, char **argv) {
    int round;
    if (argc != 2) return 2;
    scene_u8(pixels, 240, 160, 240);
    for (round = 0; round < 13; round++) {
        void *library = dlopen(argv[1], RTLD_NOW | RTLD_LOCAL);
        pthread_t thread;
        if (!library) {
            fprintf(stderr, "%s\n", dlerror());
            return 1;
        }
        /* The last round calls from this thread: what its thread-local storage holds of the library keeps it loaded until the
           thread ends, which must be as harmless. */
        if (round < 12) {
            CHECK(pthread_create(&thread, NULL, use, library) == 0 && pthread_join(thread, NULL) == 0);
        } else {
            use(library);
        }
        CHECK(dlclose(library) == 0);
        if (round < 12) CHECK(dlopen(argv[1], RTLD_NOW | RTLD_NOLOAD) == NULL);
        /* A thread that was left behind would crash now, in code that is gone. */
        nanosleep(&(struct timespec){0, 20 * 1000 * 1000}, NULL);
    }
    return check_end();
}
