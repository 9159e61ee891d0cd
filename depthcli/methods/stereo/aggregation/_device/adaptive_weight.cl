// Adaptive support weights. Colors are (H, 3, W) float; (H, W, D) COST into OUT.
#ifndef COST
#define COST uchar
#define OUT ushort
#define SQUARED 0
#endif
// A group works on TILE pixels of a row and LANES disparities; TAPS neighbors of a window row at a time.
#define TILE 32
#define LANES 64
#define TAPS 33
#define THREADS 256
#define OWN (TILE * LANES / THREADS)

// 2^-z, z >= 0 (as the processor's kernels compute it).
DEVICE float exp2_minus(float z)
{
    z = smaller_f(z, 125.0f);
    int n = (int)z;
    float u = 0.6931472f * (0.5f - (z - (float)n));
    float series = 1.0f + u * (1.0f + u * (0.5f + u * ((float)(1.0 / 6) + u * ((float)(1.0 / 24) +
                   u * ((float)(1.0 / 120) + u * (float)(1.0 / 720))))));
    return 0.70710678f * series * AS_FLOAT((127 - n) << 23);
}

// Weight of column u of row v for column x of row y of one view.
DEVICE float weight_of(GLOBAL const float *RESTRICT colors, int width, int y, int x, int v, int u, float log_color,
                       float log_space)
{
    float distance = 0;
    for (int c = 0; c < 3; c++) {
        float apart = colors[((index_t)y * 3 + c) * width + x] - colors[((index_t)v * 3 + c) * width + u];
        distance += apart * apart;
    }
    float space = (float)((v - y) * (v - y) + (u - x) * (u - x));
    if (!SQUARED) {
        distance = sqrt(distance);
        space = sqrt(space);
    }
    return exp2_minus(space * log_space + log_color * distance);
}

DEVICE OUT mean_of(float sum, float weights, float own, float factor, float rounding)
{
    return (OUT)(weights > 0 ? sum / weights * factor + rounding : own * factor);
}

// The weights of a window row are computed once a group, into local memory, for the left pixels of the tile and for
// all right pixels that they may match; sums stay in registers.
KERNEL void shared_weights(GLOBAL const COST *RESTRICT costs, GLOBAL const float *RESTRICT left,
                           GLOBAL const float *RESTRICT right, GLOBAL OUT *RESTRICT means, int height, int width,
                           int n_disparities, int radius, float log_color, float log_space, float factor, float rounding)
{
    LOCAL float left_weights[TAPS][TILE];
    LOCAL float right_weights[TAPS][TILE + LANES];
    int thread = LOCAL_ID(0);
    int x0 = GROUP_ID(0) * TILE, d0 = GROUP_ID(1) * LANES, y = GROUP_ID(2);
    int lane = thread % LANES, d = d0 + lane, own = thread / LANES;
    int first_right = x0 - d0 - (LANES - 1);
    float sums[OWN], weights[OWN];
    for (int k = 0; k < OWN; k++)
        sums[k] = weights[k] = 0;
    for (int v = larger(0, y - radius); v <= smaller(height - 1, y + radius); v++)
        for (int first = -radius; first <= radius; first += TAPS) {
            int taps = smaller(TAPS, radius - first + 1);
            for (int i = thread; i < taps * TILE; i += THREADS) {
                int x = x0 + i % TILE, u = x + first + i / TILE;
                left_weights[i / TILE][i % TILE] =
                    x < width && u >= 0 && u < width ? weight_of(left, width, y, x, v, u, log_color, log_space) : 0;
            }
            for (int i = thread; i < taps * (TILE + LANES - 1); i += THREADS) {
                int tap = i / (TILE + LANES - 1), k = i % (TILE + LANES - 1);
                int x = first_right + k, u = x + first + tap;
                right_weights[tap][k] = x >= 0 && x < width && u >= 0 && u < width
                                            ? weight_of(right, width, y, x, v, u, log_color, log_space) : 0;
            }
            BARRIER();
            if (d < n_disparities)
                for (int k = 0; k < OWN; k++) {
                    int column = own + k * (THREADS / LANES), x = x0 + column;
                    int low = larger(0, -(x + first)), high = smaller(taps, width - x - first);
                    GLOBAL const COST *cost = costs + ((index_t)v * width + x + first) * n_disparities + d;
                    float sum = sums[k], total = weights[k];
                    for (int tap = low; tap < high; tap++) {
                        float weight = left_weights[tap][column] * right_weights[tap][column + LANES - 1 - lane];
                        sum += weight * (float)cost[(index_t)tap * n_disparities];
                        total += weight;
                    }
                    sums[k] = sum;
                    weights[k] = total;
                }
            BARRIER();
        }
    if (d < n_disparities)
        for (int k = 0; k < OWN; k++) {
            int x = x0 + own + k * (THREADS / LANES);
            if (x < width) {
                index_t cell = ((index_t)y * width + x) * n_disparities + d;
                means[cell] = mean_of(sums[k], weights[k], (float)costs[cell], factor, rounding);
            }
        }
}
