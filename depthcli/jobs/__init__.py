"""Load, run, save: the only place where files meet algorithms."""
