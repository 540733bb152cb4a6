"""Localisation and mapping by scans where the pose is not given: kernels for one robot, batch from outside.

`scans` reads ranges, `points` holds the sparse point map, `matching` registers a scan in it, `search` finds a pose
without a good guess, `tracking` joins them to a step; `graph` and `closing` are for loops.
"""
