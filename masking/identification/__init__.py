"""Identification: from recordings of a rig to what its parts are."""
