"""The paper's single-track model and study as others would write them: in C, in numpy, in JAX, with sbi alone."""
