// Means over cross supports. Arms are (4, H, W) uchar: left, right, up, down. d is the fastest index of threads.
#ifndef SHIFT
#define SHIFT 0
#endif
// The sum of an arm is kept in 16 bits: divided by 2^SHIFT, rounded.

// Median of the 3 x 3 pixels around each of an RGB image, borders repeated.
KERNEL void median_3(GLOBAL const uchar *RESTRICT image, GLOBAL uchar *RESTRICT out, int height, int width)
{
    OWN_PIXEL;
    for (int c = 0; c < 3; c++) {
        uchar sample[9];
        int n = 0;
        for (int dy = -1; dy <= 1; dy++)
            for (int dx = -1; dx <= 1; dx++) {
                index_t at = (index_t)within(0, y + dy, height - 1) * width + within(0, x + dx, width - 1);
                uchar value = image[3 * at + c];
                int k = n++;
                for (; k > 0 && sample[k - 1] > value; k--)
                    sample[k] = sample[k - 1];
                sample[k] = value;
            }
        out[3 * ((index_t)y * width + x) + c] = sample[4];
    }
}

DEVICE int color_distance(GLOBAL const uchar *a, GLOBAL const uchar *b)
{
    int first = distance_of(a[0], b[0]), second = distance_of(a[1], b[1]), third = distance_of(a[2], b[2]);
    return larger(first, larger(second, third));
}

KERNEL void grow_arms(GLOBAL const uchar *RESTRICT image, GLOBAL uchar *RESTRICT arms, int height, int width,
                      int length, int threshold, int inner_length, int inner_threshold, int step_threshold)
{
    OWN_PIXEL;
    int side = GLOBAL_ID(2);
    int room = side == 0 ? x : side == 1 ? width - 1 - x : side == 2 ? y : height - 1 - y;
    index_t step = 3 * (side == 0 ? -1 : side == 1 ? 1 : side == 2 ? -(index_t)width : (index_t)width);
    GLOBAL const uchar *center = image + 3 * ((index_t)y * width + x);
    GLOBAL const uchar *pixel = center;
    int arm = 0;
    for (int n = 1; n <= smaller(length, room); n++) {
        GLOBAL const uchar *next = pixel + step;
        if (color_distance(center, next) > (n <= inner_length ? threshold : inner_threshold) ||
            color_distance(pixel, next) > step_threshold)
            break;
        pixel = next;
        arm = n;
    }
    arms[((index_t)side * height + y) * width + x] = (uchar)larger(arm, smaller(1, room));
}

// 1 / number of pixels of every support. ``across``: horizontal arms on the vertical one.
KERNEL void inverse_areas(GLOBAL const uchar *RESTRICT arms, GLOBAL float *RESTRICT inverse, int height, int width,
                          int across)
{
    OWN_PIXEL;
    index_t plane = (index_t)height * width, here = (index_t)y * width + x;
    index_t step = across ? width : 1;
    GLOBAL const uchar *first = arms + (across ? 0 : 2) * plane, *second = arms + (across ? 2 : 0) * plane;
    int area = 0;
    for (int k = -(int)second[here]; k <= (int)second[here + plane]; k++) {
        index_t at = here + k * step;
        area += first[at] + first[at + plane] + 1;
    }
    inverse[here] = 1.0f / (float)area;
}

DEVICE ushort rounded(uint sum)
{
    return (ushort)((sum + ((1u << SHIFT) >> 1)) >> SHIFT);
}

DEVICE ushort mean_of(uint sum, float inverse)
{
    float factor = inverse * (float)(1 << SHIFT);
    return (ushort)(int)((float)(int)sum * factor + 0.5f);
}

// Sums from a line's start up to and with each cell, along x or y; a thread a line of cells.
// ``lines``: threads' lines; ``inner``: cells between neighbors on a line; ``count``: cells of a line.
DEVICE index_t line_start(int i, int across, int n_disparities, int count)
{
    return across ? (index_t)(i / n_disparities) * count * n_disparities + i % n_disparities : i;
}

KERNEL void prefix(GLOBAL const ushort *RESTRICT source, GLOBAL uint *RESTRICT sums, int lines, int width, int n_disparities,
                   int count, int across)
{
    OWN_INDEX(i, lines);
    index_t at = line_start(i, across, n_disparities, count), step = across ? n_disparities : (index_t)width * n_disparities;
    uint sum = 0;
    for (int k = 0; k < count; k++, at += step) {
        sum += source[at];
        sums[at] = sum;
    }
}

// Sum of one arm pair from the sums above: of the first pass rounded, of the last one the mean.
KERNEL void spans(GLOBAL const uint *RESTRICT sums, GLOBAL const uchar *RESTRICT arms,
                  GLOBAL const float *RESTRICT inverse, GLOBAL ushort *RESTRICT out, int height, int width, int n_disparities,
                  int across, int last)
{
    OWN_CELL;
    index_t plane = (index_t)height * width, here = (index_t)y * width + x, step = across ? 1 : width;
    GLOBAL const uchar *arm = arms + (across ? 0 : 2) * plane;
    int before = arm[here], after = arm[here + plane], place = across ? x : y;
    uint sum = sums[(here + after * step) * n_disparities + d];
    if (place > before)
        sum -= sums[(here - (before + 1) * step) * n_disparities + d];
    out[here * n_disparities + d] = last ? mean_of(sum, inverse[here]) : rounded(sum);
}

// Means over cross supports whose arms are cut to those of the match: they depend on d. Words of the first pass hold
// the sum of an arm above 9 bits of its length; of the second, sum << 32 | number.
#define LENGTH_BITS 9

DEVICE int cut_arm(GLOBAL const uchar *RESTRICT arms, GLOBAL const uchar *RESTRICT target, index_t here, int x, int d)
{
    return smaller(arms[here], d <= x ? target[here - d] : 255);
}

KERNEL void prefix_spans(GLOBAL const uint *RESTRICT words, GLOBAL ulong *RESTRICT sums, int lines, int width,
                         int n_disparities, int count, int across)
{
    OWN_INDEX(i, lines);
    index_t at = line_start(i, across, n_disparities, count), step = across ? n_disparities : (index_t)width * n_disparities;
    ulong sum = 0;
    for (int k = 0; k < count; k++, at += step) {
        uint word = words[at];
        sum += ((ulong)(word >> LENGTH_BITS) << 32) | (word & ((1u << LENGTH_BITS) - 1));
        sums[at] = sum;
    }
}

#define SPAN \
    OWN_CELL; \
    index_t plane = (index_t)height * width, here = (index_t)y * width + x, step = across ? 1 : width; \
    index_t side = (across ? 0 : 2) * plane; \
    int before = cut_arm(arms + side, target + side, here, x, d); \
    int after = cut_arm(arms + side + plane, target + side + plane, here, x, d); \
    int inside = (across ? x : y) > before; \
    index_t high = (here + after * step) * n_disparities + d, low = (here - (before + 1) * step) * n_disparities + d;

KERNEL void cut_spans(GLOBAL const uint *RESTRICT sums, GLOBAL const uchar *RESTRICT arms,
                      GLOBAL const uchar *RESTRICT target, GLOBAL uint *RESTRICT words, int height, int width,
                      int n_disparities, int across)
{
    SPAN
    uint sum = sums[high] - (inside ? sums[low] : 0);
    words[here * n_disparities + d] = (sum << LENGTH_BITS) | (uint)(before + after + 1);
}

KERNEL void cut_means(GLOBAL const ulong *RESTRICT sums, GLOBAL const uchar *RESTRICT arms,
                      GLOBAL const uchar *RESTRICT target, GLOBAL ushort *RESTRICT means, int height, int width,
                      int n_disparities, int across)
{
    SPAN
    ulong sum = sums[high] - (inside ? sums[low] : 0);
    float number = (float)(int)(uint)sum;
    means[here * n_disparities + d] = (ushort)(int)((float)(int)(sum >> 32) / number + 0.5f);
}
