"""Pictures in files of cameras and of other programs: their samples, and what they state."""
