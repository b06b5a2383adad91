"""What is learnt: observations and the estimate of moduli."""
