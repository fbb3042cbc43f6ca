"""Makes the paper's Table 1 and figures again, with our valve and our controllers."""
