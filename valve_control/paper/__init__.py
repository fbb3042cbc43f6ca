"""The paper's figures and its Table 1, from our valve and our controllers."""
