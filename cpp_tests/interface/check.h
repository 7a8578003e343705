/* CHECK: says what failed, goes on, and the program's exit code tells. */
#ifndef CHECK_H
#define CHECK_H

#include <stdio.h>

static int check_failures = 0;
static int check_count = 0;

#define CHECK(condition)                                                                                    \
    do {                                                                                                    \
        check_count++;                                                                                      \
        if (!(condition)) {                                                                                 \
            check_failures++;                                                                               \
            fprintf(stderr, "%s:%d: not true: %s\n", __FILE__, __LINE__, #condition);                       \
        }                                                                                                   \
    } while (0)

static int check_end(void) {
    printf("%d checks, %d failed\n", check_count, check_failures);
    return check_failures == 0 && check_count > 0 ? 0 : 1;
}

#endif
