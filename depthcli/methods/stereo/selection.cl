// Winner-takes-all of both views, and the steps that read single costs: (H, W, D) COST.
#ifndef COST
#define COST ushort
#endif
#define LANES 32
#define PIXELS 8

// Cost and disparity share one key, so that a plain minimum finds both and the smaller disparity wins ties. A group
// has PIXELS pixels with LANES threads each; ``diagonal``: costs of the right view, c(x + d, d).
KERNEL void winners(GLOBAL const COST *RESTRICT costs, GLOBAL ushort *RESTRICT best, int height, int width, int n_disparities,
                    int diagonal)
{
    LOCAL uint keys[PIXELS][LANES];
    int lane = LOCAL_ID(0), row = LOCAL_ID(1);
    int x = GLOBAL_ID(1), y = GROUP_ID(2);
    uint found = 0xFFFFFFFFu;
    if (x < width) {
        index_t here = (index_t)y * width + x;
        int count = smaller(n_disparities, diagonal ? width - x : x + 1);
        for (int d = lane; d < count; d += LANES) {
            uint key = ((uint)costs[(here + (diagonal ? d : 0)) * n_disparities + d] << 16) | (uint)d;
            found = key < found ? key : found;
        }
    }
    keys[row][lane] = found;
    BARRIER();
    for (int reach = LANES / 2; reach > 0; reach /= 2) {
        if (lane < reach && keys[row][lane + reach] < keys[row][lane])
            keys[row][lane] = keys[row][lane + reach];
        BARRIER();
    }
    if (lane == 0 && x < width)
        best[(index_t)y * width + x] = (ushort)(keys[row][0] & 0xFFFFu);
}

// The map of the winners: their values, no status bits.
KERNEL void start_map(GLOBAL const ushort *RESTRICT best, GLOBAL float *RESTRICT values, GLOBAL uchar *RESTRICT status,
                      int count)
{
    OWN_INDEX(i, count);
    values[i] = (float)best[i];
    status[i] = 0;
}

KERNEL void move_to_minimum(GLOBAL const COST *RESTRICT costs, GLOBAL const float *RESTRICT values,
                            GLOBAL float *RESTRICT moved, int height, int width, int n_disparities)
{
    OWN_PIXEL;
    index_t here = (index_t)y * width + x;
    float value = values[here];
    moved[here] = value;
    if (no_value(value))
        return;
    int d = (int)value;
    if (value != (float)d || d < 1 || d + 1 >= smaller(n_disparities, x + 1))
        return;
    GLOBAL const COST *cost = costs + here * n_disparities + d;
    real below = cost[-1], own = cost[0], above = cost[1];
    real curvature = below + above - 2 * own;
    if (below >= own && above >= own && curvature > 0)
        moved[here] = (float)((real)d + (real)0.5 * (below - above) / curvature);
}

KERNEL void left_right_check(GLOBAL const float *RESTRICT values, GLOBAL const uchar *RESTRICT status,
                             GLOBAL const ushort *RESTRICT right, GLOBAL float *RESTRICT checked,
                             GLOBAL uchar *RESTRICT reasons, int height, int width, int disparities, float tolerance)
{
    OWN_PIXEL;
    index_t row = (index_t)y * width, here = row + x;
    float d = values[here];
    checked[here] = d;
    reasons[here] = status[here];
    if (no_value(d))
        return;
    int u = x - (int)(d + 0.5f);
    if (u >= 0 && fabs(d - (float)right[row + u]) <= tolerance)
        return;
    int mutual = 0;
    for (int other = 0; other < smaller(disparities, x + 1) && !mutual; other++)
        mutual = right[row + x - other] == other;
    checked[here] = NO_VALUE;
    reasons[here] = (uchar)(status[here] | (mutual ? 2 : 1));
}
