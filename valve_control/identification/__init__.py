"""Identification: frequency responses from records, rational fits, and compensators made from them."""
