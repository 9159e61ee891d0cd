// Feature images from grey ones; a thread a pixel. Borders are repeated outwards.
#ifndef GREY
#define GREY uchar
#endif

KERNEL void census(GLOBAL const GREY *RESTRICT image, GLOBAL ulong *RESTRICT bits, int height, int width, int ry, int rx)
{
    int x = GLOBAL_ID(0), y = GLOBAL_ID(1);
    if (x >= width || y >= height)
        return;
    int center = image[(index_t)y * width + x];
    ulong word = 0;
    for (int dy = -ry; dy <= ry; dy++) {
        GLOBAL const GREY *row = image + (index_t)within(0, y + dy, height - 1) * width;
        for (int dx = -rx; dx <= rx; dx++)
            if (dx != 0 || dy != 0)
                word = (word << 1) | (ulong)(row[within(0, x + dx, width - 1)] > center);
    }
    bits[(index_t)y * width + x] = word;
}

KERNEL void rank(GLOBAL const GREY *RESTRICT image, GLOBAL uchar *RESTRICT ranks, int height, int width, int ry, int rx)
{
    int x = GLOBAL_ID(0), y = GLOBAL_ID(1);
    if (x >= width || y >= height)
        return;
    int center = image[(index_t)y * width + x], darker = 0;
    for (int dy = -ry; dy <= ry; dy++) {
        GLOBAL const GREY *row = image + (index_t)within(0, y + dy, height - 1) * width;
        for (int dx = -rx; dx <= rx; dx++)
            darker += row[within(0, x + dx, width - 1)] < center;
    }
    ranks[(index_t)y * width + x] = (uchar)darker;
}

// Derivatives along x and y by two separable filters of five taps, into (H, W, 2) sixteenths of a grey level.
KERNEL void gradient(GLOBAL const GREY *RESTRICT image, GLOBAL const float *RESTRICT smooth,
                     GLOBAL const float *RESTRICT slope, float unit, GLOBAL short *RESTRICT out, int height, int width)
{
    int x = GLOBAL_ID(0), y = GLOBAL_ID(1);
    if (x >= width || y >= height)
        return;
    float across = 0, down = 0;
    for (int dy = -2; dy <= 2; dy++) {
        GLOBAL const GREY *row = image + (index_t)within(0, y + dy, height - 1) * width;
        float sloped = 0, smoothed = 0;
        for (int dx = -2; dx <= 2; dx++) {
            float value = (float)row[within(0, x + dx, width - 1)] * unit;
            sloped += slope[dx + 2] * value;
            smoothed += smooth[dx + 2] * value;
        }
        across += smooth[dy + 2] * sloped;
        down += slope[dy + 2] * smoothed;
    }
    index_t at = ((index_t)y * width + x) * 2;
    out[at] = (short)rint(across);
    out[at + 1] = (short)rint(down);
}
