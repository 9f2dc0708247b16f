"""Discovery: which physical effect a model is missing, found from a record that it does not reproduce."""
