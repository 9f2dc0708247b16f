"""Control: blocks L, D, G and T, the law, observers, instruments, and the closed loop, continuous or sampled."""
