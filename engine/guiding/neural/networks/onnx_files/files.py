# SPDX-License-Identifier: GPL-3.0-or-later
"""Networks saved as `.onnx` and loaded again: the very snapshot that was saved, or an error that says why not.

Any program that reads ONNX can run such a file. What is more, the model's metadata say all that a render needs to go on
from it, each under a key that begins with "neuralguide.": `format` (a number), `kind` of network, `shape` (JSON),
`bounds` [m] of what grids resolve, `scale` of radiance, `span` of u from the shutter's opening to its closing,
`version`, `step` and `loss` of the training, and a `checksum` of the metadata and parameters.
"""

from __future__ import annotations

import json
import os
import tempfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.neural.networks.mixture.shape import MixtureShape
from engine.guiding.neural.networks.onnx_files.messages import Model, read_metadata, read_model, write_model
from engine.guiding.neural.networks.onnx_files.mixture import mixture_graph
from engine.guiding.neural.networks.onnx_files.parameters import gather_parameters
from engine.guiding.neural.networks.onnx_files.protobuf import ProtobufError
from engine.guiding.neural.networks.onnx_files.radiance import radiance_graph
from engine.guiding.neural.networks.radiance import NetworkShape, Snapshot
from engine.guiding.records.training_rows import SHUTTER_SPAN
from engine.runtime.plain_files import read_plain

#: Number of the format that is written; files of a higher one are refused.
FORMAT = 1
#: A message of protocol buffers is smaller than this [bytes].
MAX_FILE_BYTES = (1 << 31) - 1

_PREFIX = "neuralguide."
_SHAPES: dict[str, type[NetworkShape] | type[MixtureShape]] = {
    NetworkShape.kind: NetworkShape, MixtureShape.kind: MixtureShape,
}  # fmt: skip


class NetworkFileError(ValueError):
    """A file that holds no network which can be used; the text says why and what helps."""


@dataclass(frozen=True)
class StoredNetwork:
    """What a file holds.

    shape : NetworkShape or MixtureShape
    snapshot : Snapshot
    span : (float, float), u at the shutter's opening and closing (`inference.make_mixture_network`)
    """

    shape: NetworkShape | MixtureShape
    snapshot: Snapshot
    span: tuple[float, float] = SHUTTER_SPAN


def network_to_onnx(network: StoredNetwork) -> bytes:
    """A network as the bytes of an `.onnx` file, a function of the network alone.

    Raises
    ------
    ValueError
        If the snapshot is not valid for the shape, or the file would be larger than `MAX_FILE_BYTES`.
    """
    shape, snapshot = network.shape, network.snapshot
    if 4 * shape.parameter_count > MAX_FILE_BYTES:
        raise ValueError(f"a network of {shape.parameter_count} parameters does not fit into an ONNX file: 2 GiB")
    graph = radiance_graph(shape, snapshot) if isinstance(shape, NetworkShape) else mixture_graph(shape, snapshot)
    metadata = {
        "format": str(FORMAT),
        "kind": shape.kind,
        "shape": json.dumps(asdict(shape)),
        "bounds": json.dumps(snapshot.bounds.tolist()),
        "scale": repr(float(snapshot.scale)),
        "span": json.dumps([float(u) for u in network.span]),
        "version": str(snapshot.version),
        "step": str(snapshot.step),
        "loss": repr(float(snapshot.loss)),
    }
    metadata["checksum"] = _checksum(metadata, snapshot.parameters)
    data = write_model(
        Model(graph, {_PREFIX + name: value for name, value in metadata.items()}, "NeuralGuide", str(FORMAT))
    )
    if len(data) > MAX_FILE_BYTES:
        raise ValueError(f"a network of {len(data)} bytes does not fit into an ONNX file: 2 GiB")
    return data


def network_from_onnx(data: bytes | memoryview) -> StoredNetwork:
    """The network that `network_to_onnx` made bytes of, bit for bit.

    Raises
    ------
    NetworkFileError
        Where the bytes are damaged, from another program, or of a newer version.
    """
    try:
        metadata = {
            name.removeprefix(_PREFIX): value
            for name, value in read_metadata(data).items()
            if name.startswith(_PREFIX)
        }
        if not metadata:
            raise NetworkFileError("it is no network of NeuralGuide's: choose a file that NeuralGuide has saved")
        number = int(metadata["format"])
        if number > FORMAT:
            raise NetworkFileError(
                f"it is of format {number}, and formats up to {FORMAT} are known: update NeuralGuide, or save it anew"
            )
        shape = _read_shape(metadata)
        parameters = gather_parameters(shape, read_model(data).graph.initialisers)
        if metadata.pop("checksum") != _checksum(metadata, parameters):
            raise ValueError("its checksum is wrong")
        bounds = np.array(json.loads(metadata["bounds"]), np.float32)
        snapshot = Snapshot(
            int(metadata["version"]), int(metadata["step"]), float(metadata["loss"]), float(metadata["scale"]), bounds,
            parameters,
        )
        snapshot.validate(shape)
        first, last = json.loads(metadata["span"])
        return StoredNetwork(shape, snapshot, (float(first), float(last)))
    except NetworkFileError:
        raise
    except KeyError as error:
        raise NetworkFileError(f"it is damaged (it does not say its {error.args[0]}): save it anew") from None
    except (ProtobufError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise NetworkFileError(f"it is damaged ({error}): save it anew") from None


def _read_shape(metadata: Mapping[str, str]) -> NetworkShape | MixtureShape:
    """The shape that metadata describe; sizes that an older version did not have are those of the defaults."""
    kind = metadata["kind"]
    if kind not in _SHAPES:
        raise NetworkFileError(f"it holds a network of the kind {kind!r}, which is not known: update NeuralGuide")
    cls = _SHAPES[kind]
    sizes: dict[str, Any] = json.loads(metadata["shape"])
    if not isinstance(sizes, dict):
        raise ValueError("its shape is no list of sizes by name")
    defaults = {item.name: item.default for item in fields(cls)}
    for name, value in sizes.items():
        if name not in defaults:
            raise NetworkFileError(f"its network has a size that is not known ({name}): update NeuralGuide")
        if type(value) is not type(defaults[name]):
            raise ValueError(f"{name} is {value!r}")
    return cls(**sizes)


def _checksum(metadata: Mapping[str, str], parameters: Float32Array) -> str:
    """CRC-32 of all that a snapshot is restored from."""
    text = json.dumps(sorted(metadata.items())).encode()
    return str(zlib.crc32(np.ascontiguousarray(parameters, "<f4").data, zlib.crc32(text)))


def save_network(path: str | Path, network: StoredNetwork) -> None:
    """Write a network to a file; whoever reads it meanwhile finds the old file or the new one, each whole.

    Raises
    ------
    ValueError
        As `network_to_onnx`.
    OSError
        If the file cannot be written.
    """
    path, data = Path(path), network_to_onnx(network)
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def load_network(path: str | Path) -> StoredNetwork:
    """The network of a file.

    Raises
    ------
    NetworkFileError
        Naming the file, where it holds none that can be used (`network_from_onnx`), or is larger than one can be.
    OSError
        If the file cannot be read.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise NetworkFileError("it is larger than 2 GiB, as no network is: choose another file")
        return network_from_onnx(read_plain(path, MAX_FILE_BYTES))
    except NetworkFileError as error:
        raise NetworkFileError(f"{path}: {error}") from None
