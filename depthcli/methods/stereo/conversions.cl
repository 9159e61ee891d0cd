// Grey of RGB as the processor's library rounds it (15 bits).
KERNEL void luma(GLOBAL const uchar *RESTRICT image, GLOBAL uchar *RESTRICT grey, int height, int width)
{
    OWN_PIXEL;
    index_t at = (index_t)y * width + x;
    int sum = 9798 * image[3 * at] + 19235 * image[3 * at + 1] + 3735 * image[3 * at + 2];
    grey[at] = (uchar)((sum + (1 << 14)) >> 15);
}
// uint8 costs times a factor.
KERNEL void to_fixed_point(GLOBAL const uchar *RESTRICT costs, GLOBAL ushort *RESTRICT fixed, int row, int height,
                           int factor)
{
    int i = GLOBAL_ID(0), y = GLOBAL_ID(1);
    if (i >= row || y >= height)
        return;
    index_t cell = (index_t)y * row + i;
    fixed[cell] = (ushort)(costs[cell] * factor);
}
