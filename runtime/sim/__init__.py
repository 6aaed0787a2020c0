"""Simulated faults: production engines, owner and recovery on a network, a clock and disks made from a seed."""
