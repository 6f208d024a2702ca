"""The live loop: frames in as they come, poses out, the newest first."""
