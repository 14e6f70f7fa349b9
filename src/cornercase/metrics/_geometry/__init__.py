"""Building blocks of several metrics: boxes, tracks, gaps along the ego's path, compiled kernels."""
