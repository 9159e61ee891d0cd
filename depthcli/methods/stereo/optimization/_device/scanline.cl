// Dynamic programming along paths. A group goes along one path; its threads share the disparities.
#ifndef COST
#define COST uchar
#define ROOM 64
#define THREADS 64
#endif

// 1 where the pixel to the left, upper left, above, upper right differs in color: (4, H, W).
KERNEL void path_edges(GLOBAL const uchar *RESTRICT image, GLOBAL uchar *RESTRICT edges, int height, int width,
                       int threshold)
{
    OWN_PIXEL;
    int k = GLOBAL_ID(2);
    int v = y - (k == 0 ? 0 : 1), u = x + (k < 2 ? -1 : k - 2);
    uchar edge = 0;
    if (v >= 0 && u >= 0 && u < width)
        for (int c = 0; c < 3; c++)
            edge |= (uchar)(distance_of(image[3 * ((index_t)y * width + x) + c],
                                        image[3 * ((index_t)v * width + u) + c]) > threshold);
    edges[((index_t)k * height + y) * width + x] = edge;
}

// Steps of the eight directions; opposite ones look across the same edge, at the pixel that comes later in the image.
DEVICE int step_x(int direction)
{
    return direction == 0 || direction == 4 || direction == 7 ? 1 : direction == 2 || direction == 3 ? 0 : -1;
}

DEVICE int step_y(int direction)
{
    return direction < 2 ? 0 : direction == 2 || direction == 4 || direction == 5 ? 1 : -1;
}

// Directions 0 .. 3: from the left, right, above, below; 4 .. 7: from upper left, upper right, lower right, lower left.
// ``sums`` holds a volume a direction of this launch.
KERNEL void paths(GLOBAL const COST *RESTRICT costs, GLOBAL const uchar *RESTRICT edges, GLOBAL ushort *RESTRICT sums,
                  int height, int width, int n_disparities, int first_direction, int p1, int p2, int p1_edge, int p2_edge)
{
    LOCAL int path[2][ROOM + 2];
    LOCAL int least[THREADS];
    int thread = LOCAL_ID(0), line = GROUP_ID(0), direction = first_direction + GROUP_ID(1);
    int dx = step_x(direction), dy = step_y(direction);
    int lines = dy == 0 ? height : dx == 0 ? width : width + height - 1;
    if (line >= lines)
        return;
    int x = dx < 0 ? width - 1 : 0, y = dy < 0 ? height - 1 : 0;
    if (dy == 0)
        y = line;
    else if (line < width)
        x = line;
    else
        y += dy * (line - width + 1);
    GLOBAL ushort *out = sums + (index_t)GROUP_ID(1) * height * width * n_disparities;
    int plane = dy == 0 ? 0 : dx == 0 ? 2 : dx == dy ? 1 : 3;
    int later = dy < 0 || (dy == 0 && dx < 0);
    int old = 0, least_before = 0, start = 1;
    for (int i = thread; i < 2 * (n_disparities + 2); i += THREADS)
        path[i / (n_disparities + 2)][i % (n_disparities + 2)] = 0x7FFF;
    BARRIER();
    for (; x >= 0 && x < width && y >= 0 && y < height; x += dx, y += dy) {
        int edge = 0;
        if (!start) {
            int u = later ? x - dx : x, v = later ? y - dy : y;
            edge = edges[((index_t)plane * height + v) * width + u];
        }
        int small = edge ? p1_edge : p1, jump = (edge ? p2_edge : p2) + least_before;
        int found = 0x7FFFFFFF;
        index_t at = ((index_t)y * width + x) * n_disparities;
        for (int d = thread; d < n_disparities; d += THREADS) {
            int value = costs[at + d];
            if (!start) {
                int near = smaller(path[old][d], path[old][d + 2]) + small;
                value += smaller(path[old][d + 1], smaller(near, jump)) - least_before;
            }
            path[1 - old][d + 1] = value;
            out[at + d] = (ushort)value;
            found = smaller(found, value);
        }
        least[thread] = found;
        BARRIER();
        for (int reach = THREADS / 2; reach > 0; reach /= 2) {
            if (thread < reach)
                least[thread] = smaller(least[thread], least[thread + reach]);
            BARRIER();
        }
        least_before = least[0];
        BARRIER();
        old = 1 - old;
        start = 0;
    }
}

KERNEL void add_paths(GLOBAL const ushort *RESTRICT sums, GLOBAL ushort *RESTRICT total, int row, int height, int count,
                      int first)
{
    int i = GLOBAL_ID(0), y = GLOBAL_ID(1);
    if (i >= row || y >= height)
        return;
    index_t cell = (index_t)y * row + i;
    uint sum = first ? 0 : total[cell];
    for (int k = 0; k < count; k++)
        sum += sums[(index_t)k * height * row + cell];
    total[cell] = (ushort)sum;
}
