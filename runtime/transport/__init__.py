"""Transports: they carry messages along edges and know nothing of epochs."""
