"""Dr.Jit image kernels: arrays in, arrays out."""
