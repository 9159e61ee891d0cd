// Connected regions of similar disparity by union of trees: every pixel points at a pixel of its region with a smaller
// index, in the end at the smallest.

KERNEL void start_regions(GLOBAL const float *RESTRICT values, GLOBAL short *RESTRICT fixed, GLOBAL int *RESTRICT parent,
                          GLOBAL int *RESTRICT sizes, int count, int steps)
{
    OWN_INDEX(i, count);
    float value = values[i];
    fixed[i] = (short)(no_value(value) ? -32768 : (int)rint(value * (float)steps));
    parent[i] = i;
    sizes[i] = 0;
}

DEVICE int root_of(volatile GLOBAL int *parent, int i)
{
    int above = parent[i];
    while (above != i) {
        i = above;
        above = parent[i];
    }
    return i;
}

DEVICE void join(volatile GLOBAL int *parent, int a, int b)
{
    for (;;) {
        a = root_of(parent, a);
        b = root_of(parent, b);
        if (a == b)
            return;
        int low = smaller(a, b), high = larger(a, b);
        int before = ATOMIC_MIN(parent + high, low);
        if (before == high)
            return;
        a = before;
        b = low;
    }
}

KERNEL void join_regions(GLOBAL const short *RESTRICT fixed, volatile GLOBAL int *parent, int height, int width,
                         int largest_step)
{
    OWN_PIXEL;
    int here = y * width + x, value = fixed[here];
    if (value == -32768)
        return;
    if (x > 0 && fixed[here - 1] != -32768 && distance_of(value, fixed[here - 1]) <= largest_step)
        join(parent, here, here - 1);
    if (y > 0 && fixed[here - width] != -32768 && distance_of(value, fixed[here - width]) <= largest_step)
        join(parent, here, here - width);
}

KERNEL void count_regions(volatile GLOBAL int *parent, GLOBAL int *RESTRICT roots, volatile GLOBAL int *sizes, int count)
{
    OWN_INDEX(i, count);
    int root = root_of(parent, i);
    roots[i] = root;
    ATOMIC_ADD(sizes + root, 1);
}

KERNEL void remove_small(GLOBAL const float *RESTRICT values, GLOBAL const uchar *RESTRICT status,
                         GLOBAL const int *RESTRICT roots, GLOBAL const int *RESTRICT sizes,
                         GLOBAL float *RESTRICT kept, GLOBAL uchar *RESTRICT reasons, int count, int size)
{
    OWN_INDEX(i, count);
    float value = values[i];
    int small = !no_value(value) && sizes[roots[i]] <= size;
    kept[i] = small ? NO_VALUE : value;
    reasons[i] = (uchar)(status[i] | (small ? 2 : 0));
}
