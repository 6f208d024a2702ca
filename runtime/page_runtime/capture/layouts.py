"""What a command line may say of capture before anything is loaded; imports nothing."""

from __future__ import annotations

# How `convert` can write frames.
LAYOUTS = ("recording", "mcap", "ros2-mcap", "ros2-sqlite3", "tum", "pictures", "video")
# The most, s, by which colour and depth of a frame differ: a Kinect's two clocks need as much.
WINDOW_S = 0.02
