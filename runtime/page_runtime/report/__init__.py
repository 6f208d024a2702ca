"""Pages for people: one HTML file with its plots and pictures inside, which opens anywhere and needs nothing."""
