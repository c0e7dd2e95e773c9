"""The noise of a camera, from pairs of frames (photon transfer), and its dark signal."""
