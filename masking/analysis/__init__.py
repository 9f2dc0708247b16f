"""Analysis of motions: masking error, synchronisation, stability and its proofs."""
