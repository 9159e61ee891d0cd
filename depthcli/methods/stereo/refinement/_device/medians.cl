// Medians of windows.
#define SMOOTHED 32

// Median of WINDOW x WINDOW values. Pixels whose window holds a pixel without value keep theirs. Borders are repeated.
#ifndef WINDOW
#define WINDOW 3
#endif
KERNEL void plain_median(GLOBAL const float *RESTRICT values, GLOBAL const uchar *RESTRICT status,
                         GLOBAL float *RESTRICT filtered, GLOBAL uchar *RESTRICT reasons, int height, int width)
{
    OWN_PIXEL;
    index_t here = (index_t)y * width + x;
    float sample[WINDOW * WINDOW], middle = values[here];
    int n = 0, whole = 1;
    for (int dy = -(WINDOW / 2); dy <= WINDOW / 2; dy++)
        for (int dx = -(WINDOW / 2); dx <= WINDOW / 2; dx++) {
            float value = values[(index_t)within(0, y + dy, height - 1) * width + within(0, x + dx, width - 1)];
            whole &= !no_value(value);
            sample[n++] = value;
        }
    if (whole) {
        // The middle one has as many below as above it; equal values are ordered by their position.
        for (int i = 0; i < WINDOW * WINDOW; i++) {
            int below = 0;
            for (int k = 0; k < WINDOW * WINDOW; k++)
                below += sample[k] < sample[i] || (sample[k] == sample[i] && k < i);
            if (below == WINDOW * WINDOW / 2)
                middle = sample[i];
        }
    }
    filtered[here] = middle;
    reasons[here] = (uchar)(status[here] | (whole && middle != values[here] ? SMOOTHED : 0));
}

// Weighted median of bins of 1/8 pixel; by_color has 766 entries, by_distance (2 radius + 1)^2. The median's bin is
// found by halving: below(k) is the weight of the bins up to k.
#define PER_PIXEL 8
KERNEL void weighted_median(GLOBAL const uchar *RESTRICT image, GLOBAL const float *RESTRICT values,
                            GLOBAL const uchar *RESTRICT status, GLOBAL const float *RESTRICT by_color,
                            GLOBAL const float *RESTRICT by_distance, GLOBAL float *RESTRICT filtered,
                            int height, int width, int radius, float filled_weight)
{
    OWN_PIXEL;
    index_t here = (index_t)y * width + x;
    filtered[here] = values[here];
    if (no_value(values[here]))
        return;
    int top = larger(0, y - radius), bottom = smaller(height - 1, y + radius);
    int left = larger(0, x - radius), right = smaller(width - 1, x + radius);
    int low = 65535, high = 0, side = 2 * radius + 1;
    for (int v = top; v <= bottom; v++)
        for (int u = left; u <= right; u++) {
            float value = values[(index_t)v * width + u];
            if (!no_value(value)) {
                int bin = (int)(value * PER_PIXEL + 0.5f);
                low = smaller(low, bin);
                high = larger(high, bin);
            }
        }
    if (low >= high)
        return;
    int red = image[3 * here], green = image[3 * here + 1], blue = image[3 * here + 2];
    int middle = 65535; // the bin of all weights
    float total = 0;
    while (low < high || total == 0) {
        float below = 0;
        for (int v = top; v <= bottom; v++)
            for (int u = left; u <= right; u++) {
                index_t there = (index_t)v * width + u;
                float value = values[there];
                if (no_value(value) || (int)(value * PER_PIXEL + 0.5f) > middle)
                    continue;
                int color = distance_of(image[3 * there], red) + distance_of(image[3 * there + 1], green) +
                            distance_of(image[3 * there + 2], blue);
                float weight = by_color[color] * by_distance[(v - y + radius) * side + u - x + radius];
                below += status[there] & 16 ? weight * filled_weight : weight;
            }
        if (middle == 65535)
            total = below;
        else if (2.0f * below >= total)
            high = middle;
        else
            low = middle + 1;
        if (total == 0) // no pixel of the window has a weight
            break;
        middle = (low + high) / 2;
    }
    filtered[here] = (float)low / PER_PIXEL;
}

KERNEL void mark_changes(GLOBAL const float *RESTRICT before, GLOBAL const float *RESTRICT after,
                         GLOBAL const uchar *RESTRICT status, GLOBAL uchar *RESTRICT reasons, int count)
{
    int i = GLOBAL_ID(0);
    if (i < count)
        reasons[i] = (uchar)(status[i] | (!no_value(before[i]) && before[i] != after[i] ? SMOOTHED : 0));
}
