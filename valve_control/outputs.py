"""Files that are written whole or not at all."""

import contextlib
import io
import json
import math
import os
import tempfile
from pathlib import Path
from typing import Any

from valve_control.parameters.table import ParameterError


def check_figure(path: str | None) -> None:
    """Raise ParameterError unless ``path`` names a PNG or SVG file."""
    if path is not None and Path(path).suffix.lower() not in (".png", ".svg"):
        raise ParameterError(f"--figure {path} must end in .png or .svg")


def write(path: str, content: str | bytes) -> None:
    """Put ``content`` in the place of ``path`` in one stroke. Raises OSError."""
    target = Path(path).resolve()
    data = content.encode("utf-8") if isinstance(content, str) else content
    try:
        if target.exists() and not target.is_file():
            target.write_bytes(data)  # such as /dev/null
            return
        with tempfile.NamedTemporaryFile(
            dir=target.parent, prefix=f".{target.name}.", delete=False
        ) as stream:
            try:
                stream.write(data)
                stream.flush()
                os.chmod(stream.name, 0o644)
                os.replace(stream.name, target)
            except BaseException:  # Ctrl-C too
                with contextlib.suppress(FileNotFoundError):  # it is in its place already
                    os.unlink(stream.name)
                raise
    except OSError as error:
        error.filename = path
        raise


def as_json(result: Any) -> str:
    """``result`` as JSON; what is not finite becomes null."""
    return json.dumps(_plain(result), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if hasattr(value, "tolist"):  # numpy's
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def figure_bytes(figure: Any, path: str) -> bytes:
    """A matplotlib figure in the format that ``path`` names; the figure is closed."""
    import matplotlib.pyplot as plt

    stream = io.BytesIO()
    try:
        figure.savefig(stream, format=Path(path).suffix[1:].lower(), dpi=110)
    finally:
        plt.close(figure)
    return stream.getvalue()
