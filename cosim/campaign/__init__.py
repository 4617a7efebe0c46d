"""Many runs into one folder, in parallel processes or on a Dask cluster; every moment of it may be the last.

`store` is what stands on disk and when it counts as finished, `pool` is who runs what.
"""
