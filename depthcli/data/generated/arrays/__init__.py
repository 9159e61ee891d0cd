"""Generated scenes as numpy arrays; nothing here reads or writes files."""
