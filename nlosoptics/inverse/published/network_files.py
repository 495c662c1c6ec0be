"""Files of trained networks: tensors with texts about them, in the safetensors format."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from torch import Tensor

from ..._checks import reason
from ...errors import MissingExtraError, SceneError


def file_content(tensors: dict[str, Tensor], texts: dict[str, str]) -> bytes:
    """Return the content of a file that holds named tensors and texts.

    With several texts the content differs from call to call, since safetensors writes them in
    random order.
    """
    content: bytes = _safetensors().save(tensors, texts)
    return content


def read_file(path: Path, remedy: str) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Return the tensors and the texts of a file; ``remedy`` ends the messages of errors.

    Raises
    ------
    SceneError
        If the file cannot be read, or has another format.
    MissingExtraError
        If safetensors is not installed.
    """
    safetensors = _safetensors()
    try:
        content = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path} cannot be read ({error.strerror}); {remedy}") from None
    try:
        # the file begins with the length of a JSON header, which safetensors itself does not return
        length = int.from_bytes(content[:8], "little")
        texts = json.loads(content[8 : 8 + length]).get("__metadata__", {})
        return safetensors.load(content), texts
    except Exception as error:
        raise SceneError(f"{path} is no safetensors file ({reason(error)}); {remedy}") from None


def _safetensors() -> Any:
    try:
        import safetensors.torch
    except ImportError:
        raise MissingExtraError(
            "networks are files of safetensors, which is not installed; "
            "pip install 'nlosoptics[inverse]'"
        ) from None
    return safetensors.torch
