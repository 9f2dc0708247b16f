"""Records: recordings and measured tables on disk, their clocks and their noise."""
