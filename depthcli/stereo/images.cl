// Images and maps as a whole.
#ifndef VALUE
#define VALUE float
#endif

// Grey of RGB as the processor's library rounds it (15 bits).
KERNEL void luma(GLOBAL const uchar *RESTRICT image, GLOBAL uchar *RESTRICT grey, int height, int width)
{
    int x = GLOBAL_ID(0), y = GLOBAL_ID(1);
    if (x >= width || y >= height)
        return;
    index_t at = (index_t)y * width + x;
    int sum = 9798 * image[3 * at] + 19235 * image[3 * at + 1] + 3735 * image[3 * at + 2];
    grey[at] = (uchar)((sum + (1 << 14)) >> 15);
}

KERNEL void copy_map(GLOBAL const VALUE *RESTRICT source, GLOBAL VALUE *RESTRICT target, int count)
{
    int i = GLOBAL_ID(0);
    if (i < count)
        target[i] = source[i];
}
