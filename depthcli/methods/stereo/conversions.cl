// 16-bit grey of 8-bit RGB as the processor's library rounds it (15 bits).
KERNEL void luma(GLOBAL const uchar *RESTRICT image, GLOBAL ushort *RESTRICT grey, int height, int width)
{
    OWN_PIXEL;
    index_t at = (index_t)y * width + x;
    uint sum = 257u * (9798u * image[3 * at] + 19235u * image[3 * at + 1] + 3735u * image[3 * at + 2]);
    grey[at] = (ushort)((sum + (1u << 14)) >> 15);
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
