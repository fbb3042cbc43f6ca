# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Translates pure step functions, and all that they call, from a small subset of Python to C99.

The subset: functions of numbers and NamedTuples; assignments, also of tuples; ``if``; ``return``; arithmetic,
comparisons, ``and``, ``or``, ``not`` and conditional expressions; ``abs``, ``min``, ``max``, ``int``,
``float``, ``len`` of an array; ``for`` over a ``range``; ``in`` a tuple of constants; the functions of
FUNCTIONS from ``math``; ``all(map(math.isfinite, …))``; ``map`` where arguments are taken apart; constants of
modules; ``_replace``. Everything else is named with its file and line.

Each operation stays where it is, in the order of Python, so that a compiler that keeps to IEEE 754 gives
the same bits. Where Python goes its own way, C goes along: ``min`` and ``max`` keep the first of equals and
of what cannot be compared, ``floor`` has no negative zero, ``%`` has the sign of the divisor, ``**`` and
what else the C library computes is not evaluated by the compiler. One thing differs: what ``floor`` and
``ceil`` return is an integer in Python and a double in C, so that its negative, its product with an integer
and its remainder may be -0.0 there, where an integer has no sign of 0. ``math.hypot``, ``math.fsum`` and
others for which Python does not call the C library are no part of the subset.

``terms.py`` has the terms of C, ``emission.py`` the program; ``values.py``, ``calls.py``, ``expressions.py``
and ``statements.py`` translate a function, from its values to the whole.
"""

import ast
import inspect
import textwrap
import types
from collections.abc import Callable, Sequence
from typing import Any

from valve_control.export import emission, kinds
from valve_control.export.kinds import Kind, identifier
from valve_control.export.statements import Body
from valve_control.export.terms import Function, SubsetError

__all__ = ["Program", "SubsetError"]


class Program(emission.Program):
    """The C that a few functions need, translated from their Python."""

    def translate(self, function: Callable[..., Any], arguments: Sequence[Kind]) -> Function:
        """Translate ``function`` for arguments of these kinds, where its annotations say nothing else.

        Raises SubsetError.
        """
        if not isinstance(function, types.FunctionType):
            raise SubsetError(f"{function!r} is no function of Python, so that it cannot be exported")
        try:
            source = inspect.getsource(function)
        except (OSError, TypeError) as error:
            where = function.__code__.co_filename
            raise SubsetError(f"the source of {function.__name__} ({where}) cannot be read") from error
        parsed = ast.parse(textwrap.dedent(source)).body[0]
        body = Body(self, function, parsed, kinds.comments(textwrap.dedent(source)))
        wanted = body.arguments(arguments)
        key = (function, wanted)
        if key in self._made:
            made = self._made[key]
            if made is None:
                raise body.refused(parsed, f"{function.__name__} calls itself")
            return made
        self._made[key] = None
        module = function.__module__
        middle = "law_" if module == self._own else ""
        made = body.translate(
            self.unique(f"{self.scope(module)}_{middle}{identifier(function.__name__)}"), wanted
        )
        self._made[key] = made
        return made
