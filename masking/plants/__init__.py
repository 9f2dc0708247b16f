"""Plants: what a controller drives, through one interface, in this process or behind a wire."""
