// Filling of pixels without a value.
#define FILLED 16

// Rows first: each empty pixel gets the smaller of the nearest values of its row. Rows without values stay empty.
KERNEL void fill_rows(GLOBAL const float *RESTRICT values, GLOBAL float *RESTRICT filled, int height, int width)
{
    OWN_PIXEL;
    GLOBAL const float *row = values + (index_t)y * width;
    int before = x, after = x;
    while (before >= 0 && no_value(row[before]))
        before--;
    while (after < width && no_value(row[after]))
        after++;
    float value = NO_VALUE;
    if (before >= 0)
        value = row[before];
    if (after < width && !(value <= row[after]))
        value = row[after];
    filled[(index_t)y * width + x] = value;
}

// Columns then: in rows without values each pixel gets the nearest value above, else below; ``rows`` is that of
// fill_rows.
KERNEL void fill_columns(GLOBAL const float *RESTRICT values, GLOBAL const uchar *RESTRICT status,
                         GLOBAL const float *RESTRICT rows, GLOBAL float *RESTRICT filled,
                         GLOBAL uchar *RESTRICT reasons, int height, int width)
{
    OWN_PIXEL;
    index_t here = (index_t)y * width + x;
    int v = y;
    while (v >= 0 && no_value(rows[(index_t)v * width + x]))
        v--;
    if (v < 0) {
        v = y;
        while (v < height - 1 && no_value(rows[(index_t)v * width + x]))
            v++;
    }
    float value = rows[(index_t)v * width + x];
    filled[here] = value;
    reasons[here] = (uchar)(status[here] | (no_value(values[here]) && !no_value(value) ? FILLED : 0));
}

// Slope along the row and value at (y, x) of the surface of (y, x), from the pixels in direction ``step``: a plane by
// least squares with Huber weights. Samples are read again for every sum, since registers cannot hold them.
DEVICE void plane_along_row(GLOBAL const float *RESTRICT values, int height, int width, int y, int x, int step,
                            int rows, int reach, int support, real *slope, real *value)
{
    float start = values[(index_t)y * width + x];
    real slope_x = 0, slope_y = 0, offset = 0;
    for (int iteration = 0; iteration < 4; iteration++) {
        real s = 0, sx = 0, sy = 0, sxx = 0, sxy = 0, syy = 0, sd = 0, sxd = 0, syd = 0;
        int count = 0;
        for (int sign = -1; sign <= 1; sign += 2) {
            int column = x;
            float level = start;
            for (int k = sign == 1 ? 0 : 1; k <= rows; k++) {
                int v = y + sign * k;
                if (v < 0 || v >= height)
                    break;
                GLOBAL const float *row = values + (index_t)v * width;
                // The gap's edge moves from row to row: look for the surface near where it was.
                int found = -1;
                for (int apart = 0; apart < 12 && found < 0; apart++) {
                    int u = column + apart * step;
                    if (u >= 0 && u < width && fabs(row[u] - level) <= 1.0f)
                        found = u;
                    u = column - apart * step;
                    if (found < 0 && u >= 0 && u < width && fabs(row[u] - level) <= 1.0f)
                        found = u;
                }
                if (found < 0)
                    break;
                column = found;
                level = row[found];
                float last = level;
                int n_other = 0;
                for (int n = 0; n < reach; n++) {
                    int u = found + n * step;
                    if (u < 0 || u >= width)
                        break;
                    if (fabs(row[u] - last) <= 1.0f) {
                        n_other = 0;
                        last = row[u];
                        real across = (real)(u - x), down = (real)(v - y), d = (real)(last - start);
                        real residual = fabs(d - (slope_x * across + slope_y * down + offset));
                        real weight = iteration == 0 || residual <= (real)0.5 ? (real)1 : (real)1 / (2 * residual);
                        s += weight;
                        sx += weight * across;
                        sy += weight * down;
                        sd += weight * d;
                        sxx += weight * across * across;
                        sxy += weight * across * down;
                        syy += weight * down * down;
                        sxd += weight * across * d;
                        syd += weight * down * d;
                        count++;
                    } else if (++n_other > 3) // another surface, or no value
                        break;
                }
            }
        }
        if (count < support) {
            *slope = 0;
            *value = start;
            return;
        }
        real mean_x = sx / s, mean_y = sy / s, mean_d = sd / s;
        // One pixel of variance is added: a thin sample must not yield a steep plane.
        real xx = sxx / s - mean_x * mean_x + 1, yy = syy / s - mean_y * mean_y + 1, xy = sxy / s - mean_x * mean_y;
        real xd = sxd / s - mean_x * mean_d, yd = syd / s - mean_y * mean_d;
        real determinant = xx * yy - xy * xy;
        slope_x = (xd * yy - yd * xy) / determinant;
        slope_y = (yd * xx - xd * xy) / determinant;
        offset = mean_d - slope_x * mean_x - slope_y * mean_y;
    }
    *slope = slope_x;
    *value = (real)start + offset;
}

// Planes of the pixels beside gaps, (H, W, 4): slope and value from the pixels to the left, then to the right. One thread per pixel.
KERNEL void surfaces_at_gaps(GLOBAL const float *RESTRICT values, GLOBAL real *RESTRICT planes, int height, int width,
                             int rows, int reach, int support)
{
    OWN_PIXEL;
    index_t here = (index_t)y * width + x;
    if (no_value(values[here]))
        return;
    real slope, value;
    if (x + 1 < width && no_value(values[here + 1])) {
        plane_along_row(values, height, width, y, x, -1, rows, reach, support, &slope, &value);
        planes[4 * here] = slope;
        planes[4 * here + 1] = value;
    }
    if (x > 0 && no_value(values[here - 1])) {
        plane_along_row(values, height, width, y, x, 1, rows, reach, support, &slope, &value);
        planes[4 * here + 2] = slope;
        planes[4 * here + 3] = value;
    }
}

KERNEL void continue_surfaces(GLOBAL const float *RESTRICT values, GLOBAL const uchar *RESTRICT status,
                              GLOBAL const real *RESTRICT planes, GLOBAL float *RESTRICT filled,
                              GLOBAL uchar *RESTRICT reasons, int height, int width, float largest)
{
    OWN_PIXEL;
    index_t row = (index_t)y * width, here = row + x;
    float value = values[here];
    int reason = status[here];
    if (no_value(value)) {
        int before = x, after = x;
        while (before >= 0 && no_value(values[row + before]))
            before--;
        while (after < width && no_value(values[row + after]))
            after++;
        real found = 0;
        if (before >= 0)
            found = planes[4 * (row + before) + 1] + planes[4 * (row + before)] * (real)(x - before);
        if (after < width) {
            real other = planes[4 * (row + after) + 3] + planes[4 * (row + after) + 2] * (real)(x - after);
            found = before < 0 || other < found ? other : found;
        }
        if (before >= 0 || after < width) {
            value = smaller_f(largest, (float)(found > 0 ? found : 0));
            reason |= FILLED;
        }
    }
    filled[here] = value;
    reasons[here] = (uchar)reason;
}

#define MAX_COST 4.0f

// Cost and distance, in steps, of the nearest measured value in a direction; not less than ``limit`` without one.
DEVICE float search(GLOBAL const float *RESTRICT values, GLOBAL const uchar *RESTRICT status,
                    GLOBAL const uchar *RESTRICT image, int height, int width, int y, int x, int dy, int dx,
                    float color_rate, float distance_rate, float limit, int *distance)
{
    int edge = 0;
    for (int steps = 1;; steps++) {
        int v = y + steps * dy, u = x + steps * dx;
        if (v < 0 || v >= height || u < 0 || u >= width)
            return limit;
        index_t there = (index_t)v * width + u, before = there - (index_t)dy * width - dx;
        int change = 0;
        for (int c = 0; c < 3; c++)
            change += distance_of(image[3 * there + c], image[3 * before + c]);
        edge = larger(edge, change);
        float cost = (float)edge * color_rate + (float)steps * distance_rate;
        *distance = steps;
        if (cost >= limit || (!no_value(values[there]) && !(status[there] & FILLED)))
            return cost;
    }
}

// Filled values, but those of the strip on the left, where another direction has a cheaper one; ``image`` is smoothed.
KERNEL void replace_fills(GLOBAL const float *RESTRICT values, GLOBAL const uchar *RESTRICT status,
                          GLOBAL const uchar *RESTRICT image, GLOBAL const ushort *RESTRICT right,
                          GLOBAL float *RESTRICT replaced, GLOBAL uchar *RESTRICT reasons, int height, int width,
                          float color_rate, float distance_rate)
{
    OWN_PIXEL;
    index_t row = (index_t)y * width, here = row + x;
    float fill = values[here];
    replaced[here] = fill;
    reasons[here] = status[here];
    if (no_value(fill) || !(status[here] & FILLED))
        return;
    int before = x;
    while (before >= 0 && (no_value(values[row + before]) || (status[row + before] & FILLED)))
        before--;
    if (before < 0)
        return;
    float agreeing = MAX_COST, cheapest = MAX_COST, replacement = fill;
    for (int k = 0; k < 8; k++) {
        int axis = k / 2, sign = k % 2 ? -1 : 1, distance = 0;
        int dy = axis == 0 ? 0 : sign, dx = axis == 0 || axis == 2 ? sign : axis == 3 ? -sign : 0;
        float cost = search(values, status, image, height, width, y, x, dy, dx, color_rate, distance_rate, agreeing,
                            &distance);
        if (cost >= agreeing)
            continue;
        float value = values[here + (index_t)distance * dy * width + distance * dx];
        int u = x - (int)(value + 0.5f);
        if (u >= 0 && (float)right[row + u] < value - 1.5f)
            cost += 1.5f;
        if (fabs(value - fill) <= 2.0f + 0.3f * (float)distance)
            agreeing = smaller_f(agreeing, cost);
        else if (cost < cheapest) {
            cheapest = cost;
            replacement = value;
        }
    }
    if (cheapest + 1.0f < agreeing)
        replaced[here] = replacement;
}
