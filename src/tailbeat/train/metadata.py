"""Write what a policy's file says beside its network, which does not change."""

from pathlib import Path

import onnx

from tailbeat.control.policy import Policy, load_policy
from tailbeat.files import new_file


def put(old: Path, key: str, text: str, new: Path, overwrite: bool = False) -> Policy:
    """Write a policy's file with `text` under a key of its metadata, read it back before it gets
    its name, and load it. Raises BadInput; nothing is written then."""
    model = onnx.load(str(old))
    held = {one.key: one.value for one in model.metadata_props}
    onnx.helper.set_model_props(model, {**held, key: text})
    with new_file(new, overwrite) as beside:
        onnx.save(model, str(beside))
        load_policy(beside)
    return load_policy(new)
