"""Frames of cameras, videos, folders and recordings, and the world that shows them."""

import cv2

cv2.setNumThreads(1)  # as in tracking
