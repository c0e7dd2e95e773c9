"""The effective camera, live: each frame of an endless bracket completes a picture.

`camctl.live` gives the results; `camctl.VideoCapture` and the backend ``effective`` make a camera
of them for programs that know nothing of exposures.
"""
