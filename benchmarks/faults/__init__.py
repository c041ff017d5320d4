"""Faults: killed jobs and drivers, damaged files, two runs at once, odd clocks, full disks."""
