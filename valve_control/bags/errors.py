"""What is wrong with a bag, in one sentence."""

LONGEST = 600  # characters


class BagError(ValueError):
    """A bag, or a part of it, that cannot be used; the message is one sentence for the user.

    What it quotes from a damaged bag may be anything: it is brought to one line of bounded length.
    """

    def __str__(self) -> str:
        text = " ".join(super().__str__().split())
        return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"
