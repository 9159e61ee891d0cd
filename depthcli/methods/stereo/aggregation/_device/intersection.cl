// Means over cross supports whose arms are cut to those of the match: they depend on d. Words of the first pass hold
// the sum of an arm above 9 bits of its length; of the second, sum << 32 | number.
#define LENGTH_BITS 9

DEVICE int cut_arm(GLOBAL const uchar *RESTRICT arms, GLOBAL const uchar *RESTRICT target, index_t here, int x, int d)
{
    return smaller(arms[here], d <= x ? target[here - d] : 255);
}

KERNEL void naive_cut(GLOBAL const ushort *RESTRICT costs, GLOBAL const uchar *RESTRICT arms,
                      GLOBAL const uchar *RESTRICT target, GLOBAL ushort *RESTRICT means,
                      int height, int width, int n_disparities, int across)
{
    OWN_CELL;
    index_t plane = (index_t)height * width, here = (index_t)y * width + x;
    index_t first = (across ? 0 : 2) * plane, second = (across ? 2 : 0) * plane;
    int before = cut_arm(arms + second, target + second, here, x, d);
    int after = cut_arm(arms + second + plane, target + second + plane, here, x, d);
    uint total = 0, number = 0;
    for (int k = -before; k <= after; k++) {
        int u = across ? x : x + k;
        index_t at = here + k * (across ? width : 1);
        int low = cut_arm(arms + first, target + first, at, u, d);
        int high = cut_arm(arms + first + plane, target + first + plane, at, u, d);
        for (int n = -low; n <= high; n++)
            total += costs[(at + n * (across ? 1 : width)) * n_disparities + d];
        number += low + high + 1;
    }
    means[here * n_disparities + d] = (ushort)(int)((float)(int)total / (float)(int)number + 0.5f);
}

DEVICE index_t line_start(int i, int across, int n_disparities, int count)
{
    return across ? (index_t)(i / n_disparities) * count * n_disparities + i % n_disparities : i;
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
