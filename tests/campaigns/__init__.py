"""Campaigns: what a rig loop must survive, produced on the served twin of a rig, judged by the plant's own record."""
