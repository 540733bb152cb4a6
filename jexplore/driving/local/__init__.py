"""A robot that drives and writes its trace map by a local map: perception, planning, memory. Runs on the host."""
