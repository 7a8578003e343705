/* Reads one byte behind its memory: must be stopped by AddressSanitizer, or the other test with it says nothing. */
#include <stdint.h>
#include <stdlib.h>
#include "spivcal.h"

int main(void) {
    uint64_t context = 0, image = 0;
    volatile uint64_t height = 3;
    uint8_t *pixels = (uint8_t *)calloc(4, 2);
    if (pixels == NULL || spivcal_context_create(1, &context) != SPIVCAL_OK) return 0;
    /* The library reads what the host says is there: one row too many. */
    spivcal_image_create_u8(context, pixels, 4, (uint32_t)height, 4, &image);
    return 0;
}
