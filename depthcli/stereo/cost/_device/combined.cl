// Sum of parts, each by a table of what its 256 costs weigh; a thread a cell.

KERNEL void add_part(GLOBAL const uchar *RESTRICT costs, GLOBAL const uchar *RESTRICT table,
                     GLOBAL uchar *RESTRICT total, int first, int depth, int width, int outside, int last, int rows)
{
    int i = GLOBAL_ID(0), y = GLOBAL_ID(1);
    if (i >= width * depth || y >= rows)
        return;
    index_t cell = (index_t)y * width * depth + i;
    int sum = table[costs[cell]] + (first ? 0 : total[cell]);
    if (last && i % depth > i / depth)
        sum = outside;
    total[cell] = (uchar)sum;
}
