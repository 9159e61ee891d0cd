// Feature images from grey ones; one thread per pixel. Borders are repeated outwards.
#ifndef GREY
#define GREY uchar
#endif

KERNEL void census(GLOBAL const GREY *RESTRICT image, GLOBAL ulong *RESTRICT bits, int height, int width, int ry, int rx)
{
    OWN_PIXEL;
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
    OWN_PIXEL;
    int center = image[(index_t)y * width + x], darker = 0;
    for (int dy = -ry; dy <= ry; dy++) {
        GLOBAL const GREY *row = image + (index_t)within(0, y + dy, height - 1) * width;
        for (int dx = -rx; dx <= rx; dx++)
            darker += row[within(0, x + dx, width - 1)] < center;
    }
    ranks[(index_t)y * width + x] = (uchar)darker;
}

// Sums of five taps in the order of the processor's library, whose sums and products are fused.
DEVICE float even_taps(const float *value, GLOBAL const float *RESTRICT taps, int columns)
{
    float near = value[3] + value[1];
    float sum = columns ? fma(near, taps[3], value[2] * taps[2]) : fma(value[2], taps[2], near * taps[3]);
    return fma(value[4] + value[0], taps[4], sum);
}

DEVICE float odd_taps(const float *value, GLOBAL const float *RESTRICT taps)
{
    return fma(value[4] - value[0], taps[4], (value[3] - value[1]) * taps[3]);
}

// Derivatives along x and y by two separable filters of five taps, into (H, W, 2) sixteenths of a grey level.
KERNEL void gradient(GLOBAL const GREY *RESTRICT image, GLOBAL const float *RESTRICT smooth,
                     GLOBAL const float *RESTRICT slope, float unit, GLOBAL short *RESTRICT out, int height, int width)
{
    OWN_PIXEL;
    float sloped[5], smoothed[5];
    for (int dy = 0; dy < 5; dy++) {
        GLOBAL const GREY *row = image + (index_t)within(0, y + dy - 2, height - 1) * width;
        float value[5];
        for (int dx = 0; dx < 5; dx++)
            value[dx] = (float)row[within(0, x + dx - 2, width - 1)] * unit;
        sloped[dy] = odd_taps(value, slope);
        smoothed[dy] = even_taps(value, smooth, 0);
    }
    index_t at = ((index_t)y * width + x) * 2;
    out[at] = (short)rint(even_taps(sloped, smooth, 1));
    out[at + 1] = (short)rint(odd_taps(smoothed, slope));
}
