"""What is wrong with a bag, in one sentence."""


class BagError(ValueError):
    """A bag, or a part of it, that cannot be used; the message is one sentence for the user."""
