"""What `masking stability` proves of models whose truth is known from elsewhere."""
