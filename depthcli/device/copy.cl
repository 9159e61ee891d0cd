// Measures the bandwidth of a device.
KERNEL void copy(GLOBAL const uint *RESTRICT source, GLOBAL uint *RESTRICT target, int count)
{
    int i = GLOBAL_ID(0);
    if (i < count)
        target[i] = source[i];
}
