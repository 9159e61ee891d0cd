"""What all commands share: the scene loop, worker processes, run folders, presets, lines for people."""
