"""Where frames come from: playback of each format on disk."""
