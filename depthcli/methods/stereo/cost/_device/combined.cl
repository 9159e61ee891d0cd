// Sum of parts, each by a table of its 256 costs' shares of a pixel's unit; one thread per cell.

KERNEL void add_part(GLOBAL const uchar *RESTRICT costs, GLOBAL const float *RESTRICT table,
                     GLOBAL const float *RESTRICT units, GLOBAL uchar *RESTRICT total, int first, int n_disparities,
                     int width, int outside, int last, int rows)
{
    int i = GLOBAL_ID(0), y = GLOBAL_ID(1);
    if (i >= width * n_disparities || y >= rows)
        return;
    index_t cell = (index_t)y * width * n_disparities + i;
    int x = i / n_disparities;
    int sum = (int)(units[(index_t)y * width + x] * table[costs[cell]] + 0.5f) + (first ? 0 : total[cell]);
    if (last && i - x * n_disparities > x)
        sum = outside;
    total[cell] = (uchar)min(sum, 255);
}
