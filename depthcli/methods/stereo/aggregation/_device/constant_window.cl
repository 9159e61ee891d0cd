// Mean over a square window, clipped at the border: (H, W, D) COST into ushort. d is the fastest index of threads.
#ifndef COST
#define COST uchar
#define SUM uint
#endif

DEVICE ushort mean_of(uint sum, int rows, int columns, float factor)
{
    float scale = factor / (float)(rows * columns);
    return (ushort)(int)((float)(int)sum * scale + 0.5f);
}

// Running sums down the columns; a thread a column of cells and a band of rows. ``row`` = W * D.
KERNEL void column_sums(GLOBAL const COST *RESTRICT costs, GLOBAL SUM *RESTRICT sums, int height, int row, int radius,
                        int band)
{
    int i = GLOBAL_ID(0), first = GLOBAL_ID(1) * band;
    if (i >= row || first >= height)
        return;
    int last = smaller(height, first + band);
    uint sum = 0;
    for (int y = larger(0, first - radius); y < smaller(height, first + radius); y++)
        sum += costs[(index_t)y * row + i];
    for (int y = first; y < last; y++) {
        if (y + radius < height)
            sum += costs[(index_t)(y + radius) * row + i];
        if (y > first && y - radius - 1 >= 0)
            sum -= costs[(index_t)(y - radius - 1) * row + i];
        sums[(index_t)y * row + i] = (SUM)sum;
    }
}

// Running sums of those along the rows; one thread per row, disparity and band of columns.
KERNEL void row_means(GLOBAL const SUM *RESTRICT sums, GLOBAL ushort *RESTRICT means, int height, int width, int n_disparities,
                      int radius, float factor, int band)
{
    int d = GLOBAL_ID(0), first = GLOBAL_ID(1) * band, y = GLOBAL_ID(2);
    if (d >= n_disparities || first >= width || y >= height)
        return;
    int last = smaller(width, first + band);
    int rows = smaller(height, y + radius + 1) - larger(0, y - radius);
    GLOBAL const SUM *line = sums + (index_t)y * width * n_disparities + d;
    GLOBAL ushort *out = means + (index_t)y * width * n_disparities + d;
    uint sum = 0;
    for (int x = larger(0, first - radius); x < smaller(width, first + radius); x++)
        sum += line[(index_t)x * n_disparities];
    for (int x = first; x < last; x++) {
        if (x + radius < width)
            sum += line[(index_t)(x + radius) * n_disparities];
        if (x > first && x - radius - 1 >= 0)
            sum -= line[(index_t)(x - radius - 1) * n_disparities];
        out[(index_t)x * n_disparities] =
            mean_of(sum, rows, smaller(width, x + radius + 1) - larger(0, x - radius), factor);
    }
}
