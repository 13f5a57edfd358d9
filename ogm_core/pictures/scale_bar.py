"""The scale bar beside a map's picture."""

import math


def round_length(length: float) -> float:
    """The number 1, 2 or 5 times a power of ten that comes nearest to `length`, by ratio."""
    exponent = math.floor(math.log10(length))
    choices = [float(f"{digit}e{exponent}") for digit in (1, 2, 5, 10)]
    return min(choices, key=lambda choice: abs(math.log(choice / length)))
