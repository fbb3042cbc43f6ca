"""Identification: frequency responses from records, rational fits, and compensators made from them."""

WEIGHTINGS = ("likelihood", "relative", "uniform")  # of a fit's errors
