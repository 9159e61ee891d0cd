// Slopes of a disparity map, and the weighted median of votes along them.
#define SIDE 9
#define SAMPLES (SIDE * SIDE)
#define BLOCK 32
#define PER_PIXEL 8

// Splits a map into its values, 0 where there is none, and a trust of 1 where there is one, else 0.
KERNEL void split_values(GLOBAL const float *RESTRICT values, GLOBAL float *RESTRICT known, GLOBAL float *RESTRICT trust,
                         int count)
{
    OWN_INDEX(i, count);
    int none = no_value(values[i]);
    known[i] = none ? 0 : values[i];
    trust[i] = none ? 0 : 1;
}

KERNEL void join_values(GLOBAL const float *RESTRICT values, GLOBAL const float *RESTRICT known,
                        GLOBAL float *RESTRICT joined, int count)
{
    int i = GLOBAL_ID(0);
    if (i < count)
        joined[i] = no_value(values[i]) ? NO_VALUE : known[i];
}

DEVICE float color_distance(GLOBAL const uchar *RESTRICT image, index_t there, int red, int green, int blue)
{
    return (float)(distance_of(image[3 * there], red) + distance_of(image[3 * there + 1], green) +
                   distance_of(image[3 * there + 2], blue));
}

// Plane through samples (weight, difference from the center): slopes and offset; flat where too few agree.
DEVICE void solve(const float *sums, float *slope_x, float *slope_y, float *offset)
{
    float s = sums[0];
    int few = s < 6.0f;
    float scale = few ? 1.0f : 1.0f / s;
    float mx = sums[1] * scale, my = sums[2] * scale, md = sums[6] * scale;
    float xx = sums[3] * scale - mx * mx + 0.2f, xy = sums[4] * scale - mx * my, yy = sums[5] * scale - my * my + 0.2f;
    float xd = sums[7] * scale - mx * md, yd = sums[8] * scale - my * md;
    float determinant = xx * yy - xy * xy;
    float a = smaller_f(larger_f((xd * yy - yd * xy) / determinant, -1.0f), 1.0f);
    float b = smaller_f(larger_f((yd * xx - xd * xy) / determinant, -1.0f), 1.0f);
    *slope_x = few ? 0 : a;
    *slope_y = few ? 0 : b;
    *offset = few ? 0 : md - a * mx - b * my;
}

DEVICE void add_moments(float *sums, float weight, float difference, float dx, float dy)
{
    sums[0] += weight;
    sums[1] += dx * weight;
    sums[2] += dy * weight;
    sums[3] += dx * dx * weight;
    sums[4] += dx * dy * weight;
    sums[5] += dy * dy * weight;
    sums[6] += weight * difference;
    sums[7] += dx * weight * difference;
    sums[8] += dy * weight * difference;
}

// ``limits``: largest difference of each sample. Slopes are (2, H, W).
KERNEL void slopes(GLOBAL const float *RESTRICT known, GLOBAL const float *RESTRICT trust,
                   GLOBAL const uchar *RESTRICT image, GLOBAL const float *RESTRICT limits, GLOBAL float *RESTRICT found,
                   int height, int width, int step, float spread)
{
    OWN_PIXEL;
    index_t here = (index_t)y * width + x, plane = (index_t)height * width;
    int red = image[3 * here], green = image[3 * here + 1], blue = image[3 * here + 2];
    float near[SAMPLES], apart[SAMPLES], sums[9];
    float slope_x, slope_y, offset, squares = 0, total = 0;
    for (int n = 0; n < 9; n++)
        sums[n] = 0;
    for (int k = 0; k < SAMPLES; k++) {
        int dy = (k / SIDE - SIDE / 2) * step, dx = (k % SIDE - SIDE / 2) * step;
        near[k] = apart[k] = 0;
        if (y + dy < 0 || y + dy >= height || x + dx < 0 || x + dx >= width)
            continue;
        index_t there = here + (index_t)dy * width + dx;
        apart[k] = known[there] - known[here];
        if (color_distance(image, there, red, green, blue) <= 75.0f && fabs(apart[k]) <= limits[k])
            near[k] = trust[there];
        add_moments(sums, near[k], apart[k], (float)dx, (float)dy);
    }
    solve(sums, &slope_x, &slope_y, &offset);
    for (int n = 0; n < 9; n++)
        sums[n] = 0;
    for (int k = 0; k < SAMPLES; k++) {
        float dy = (float)((k / SIDE - SIDE / 2) * step), dx = (float)((k % SIDE - SIDE / 2) * step);
        float residual = apart[k] - offset - slope_x * dx - slope_y * dy;
        near[k] = near[k] * larger_f(1.0f - residual * residual, 0);
        add_moments(sums, near[k], apart[k], dx, dy);
    }
    solve(sums, &slope_x, &slope_y, &offset);
    for (int k = 0; k < SAMPLES; k++) {
        float dy = (float)((k / SIDE - SIDE / 2) * step), dx = (float)((k % SIDE - SIDE / 2) * step);
        float residual = apart[k] - offset - slope_x * dx - slope_y * dy;
        squares += near[k] * residual * residual;
        total += near[k];
    }
    squares /= larger_f(total, 1.0f);
    // A slope that the residuals could explain is shrunk.
    float steep = slope_x * slope_x + slope_y * slope_y;
    float doubt = 4.0f * spread * (squares + 0.01f);
    float sure = trust[here] * steep / (steep + doubt);
    found[here] = slope_x * sure;
    found[here + plane] = slope_y * sure;
}

// exp(-16 z), z >= 0, as the processor's kernels compute it.
DEVICE float exp_minus_16(float z)
{
    z = smaller_f(z, 1.0f);
    float power = 1.0f - z * (1.0f - z * (0.5f - z * (float)(1.0 / 6.0)));
    power *= power;
    power *= power;
    power *= power;
    return power * power;
}

// Places of a window that are left out have an infinite distance.
#define LEFT_OUT (distance[(v - y + radius) * side + u - x + radius] > 1e30f)

// Vote and weight of the pixel (v, u) for (y, x), whose value is ``center``; its weight is 0 where it has no value.
#define VOTE \
    float vote = center, weight = 0; \
    if (v >= 0 && v < height && u >= 0 && u < width) { \
        index_t there = (index_t)v * width + u; \
        float color = color_distance(image, there, red, green, blue); \
        weight = exp_minus_16(distance[(v - y + radius) * side + u - x + radius] + color * color_rate) * trust[there]; \
        if (trust[there] > 0) \
            vote = known[there] + gradient[there] * (float)(x - u) + gradient[there + plane] * (float)(y - v); \
    }

// A group is a block of a row, whose intervals are halved together until the widest is narrow enough.
KERNEL void slanted_median(GLOBAL const uchar *RESTRICT image, GLOBAL const float *RESTRICT known,
                           GLOBAL const float *RESTRICT trust, GLOBAL const float *RESTRICT gradient,
                           GLOBAL const float *RESTRICT distance, GLOBAL float *RESTRICT out, int height, int width,
                           int radius, float color_rate, float most)
{
    LOCAL float widths[BLOCK];
    int lane = LOCAL_ID(0), x = GLOBAL_ID(0), y = GROUP_ID(1), side = 2 * radius + 1;
    index_t plane = (index_t)height * width, here = (index_t)y * width + x;
    int red = 0, green = 0, blue = 0; // columns beyond the image fill up the last block
    float center = 0, low = 1e30f, high = -1e30f, half_weight = 0;
    if (x < width) {
        red = image[3 * here], green = image[3 * here + 1], blue = image[3 * here + 2];
        center = known[here];
    }
    for (int v = y - radius; v <= y + radius; v++)
        for (int u = x - radius; u <= x + radius; u++) {
            if (LEFT_OUT)
                continue;
            VOTE
            low = smaller_f(low, vote);
            high = larger_f(high, vote);
            half_weight += 0.5f * weight;
        }
    widths[lane] = high - low;
    BARRIER();
    for (int reach = BLOCK / 2; reach > 0; reach /= 2) {
        if (lane < reach)
            widths[lane] = larger_f(widths[lane], widths[lane + reach]);
        BARRIER();
    }
    for (float widest = widths[0]; widest > 0.5f / PER_PIXEL; widest *= 0.5f) {
        float middle = 0.5f * (low + high), below = 0;
        for (int v = y - radius; v <= y + radius; v++)
            for (int u = x - radius; u <= x + radius; u++) {
                if (LEFT_OUT)
                    continue;
                VOTE
                below += vote <= middle ? weight : 0;
            }
        if (below >= half_weight)
            high = middle;
        else
            low = middle;
    }
    if (x < width)
        out[here] = smaller_f(larger_f(rint(0.5f * (low + high) * PER_PIXEL) / PER_PIXEL, 0), most);
}
