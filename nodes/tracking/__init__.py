"""Tracking rigid objects with one camera: world → arm → spatial (example 3 of the paper)."""

import cv2

cv2.setNumThreads(1)  # in all rooms: equal pixels in every run, and no threads in the nodes' processes
