// Cost volumes (H, W, D), d fastest, from feature images of both views; one thread per cell. Cells whose match lies
// outside the right image (d > x) get ``outside``.
#ifndef FEATURE
#define FEATURE uchar
#endif
#ifndef CHANNELS
#define CHANNELS 1
#endif
// Features are (H, W, CHANNELS).

#define CELL \
    OWN_CELL; \
    index_t cell = ((index_t)y * width + x) * n_disparities + d; \
    if (d > x) { \
        costs[cell] = (uchar)outside; \
        return; \
    } \
    index_t here = (index_t)y * width + x, there = here - d;

KERNEL void hamming(GLOBAL const ulong *RESTRICT left, GLOBAL const ulong *RESTRICT right, GLOBAL uchar *RESTRICT costs,
                    int height, int width, int n_disparities, int outside)
{
    CELL
    costs[cell] = (uchar)POPCOUNT(left[here] ^ right[there]);
}

// Sum of absolute differences divided by 2^shift (rounded half up), at most ``limit``.
KERNEL void difference(GLOBAL const FEATURE *RESTRICT left, GLOBAL const FEATURE *RESTRICT right,
                       GLOBAL uchar *RESTRICT costs, int height, int width, int n_disparities, int outside, int shift, int limit)
{
    CELL
    int total = (1 << shift) >> 1;
    for (int c = 0; c < CHANNELS; c++)
        total += distance_of(left[here * CHANNELS + c], right[there * CHANNELS + c]);
    costs[cell] = (uchar)smaller(total >> shift, limit);
}

// Smallest and largest value within half a pixel along the row.
DEVICE void half_pixel(GLOBAL const FEATURE *RESTRICT image, index_t row, int x, int width, int c, int *low, int *high)
{
    int here = image[(row + x) * CHANNELS + c];
    int before = (here + image[(row + larger(x - 1, 0)) * CHANNELS + c]) >> 1;
    int after = (here + image[(row + smaller(x + 1, width - 1)) * CHANNELS + c]) >> 1;
    *low = smaller(here, smaller(before, after));
    *high = larger(here, larger(before, after));
}

// The same, insensitive to sampling (Birchfield and Tomasi, PAMI 1998).
KERNEL void tolerant_difference(GLOBAL const FEATURE *RESTRICT left, GLOBAL const FEATURE *RESTRICT right,
                                GLOBAL uchar *RESTRICT costs, int height, int width, int n_disparities, int outside,
                                int shift, int limit)
{
    CELL
    index_t row = (index_t)y * width;
    int total = (1 << shift) >> 1;
    for (int c = 0; c < CHANNELS; c++) {
        int low, high, low_there, high_there;
        int value = left[here * CHANNELS + c], other = right[there * CHANNELS + c];
        half_pixel(left, row, x, width, c, &low, &high);
        half_pixel(right, row, x - d, width, c, &low_there, &high_there);
        int one = larger(value - high_there, low_there - value), two = larger(other - high, low - other);
        total += larger(smaller(one, two), 0);
    }
    costs[cell] = (uchar)smaller(total >> shift, limit);
}
