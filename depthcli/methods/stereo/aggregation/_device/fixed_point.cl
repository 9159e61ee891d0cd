KERNEL void to_fixed_point(GLOBAL const uchar *RESTRICT costs, GLOBAL ushort *RESTRICT fixed, int row, int height,
                           int factor)
{
    int i = GLOBAL_ID(0), y = GLOBAL_ID(1);
    if (i >= row || y >= height)
        return;
    index_t cell = (index_t)y * row + i;
    fixed[cell] = (ushort)(costs[cell] * factor);
}
