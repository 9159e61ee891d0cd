// Measures the bandwidth of a device.
KERNEL void copy(GLOBAL const uint *RESTRICT source, GLOBAL uint *RESTRICT target, int count)
{
    int i = GLOBAL_ID(0);
    if (i < count)
        target[i] = source[i];
}

// Measures how many operations a device does: four chains of multiply-adds a thread, of 64 turns with 8 each.
KERNEL void multiply_add(GLOBAL float *RESTRICT target, float factor, int count)
{
    int i = GLOBAL_ID(0);
    if (i >= count)
        return;
    float a = i, b = i + 1, c = i + 2, d = i + 3;
    for (int k = 0; k < 64; ++k)
        for (int n = 0; n < 8; ++n) {
            a = a * factor + b;
            b = b * factor + c;
            c = c * factor + d;
            d = d * factor + a;
        }
    target[i] = a + b + c + d;
}
