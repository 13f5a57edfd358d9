"""The mapping core: arrays and bytes in, arrays and bytes out.

No sockets, no clocks, no settings. `import ogm_core` is cheap: the numba kernels load with `ogm_core.grid`.
"""
