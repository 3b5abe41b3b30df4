"""Keeps some of the recorded episodes: select.py FOLDER writes, beside this file, those named in EPISODES."""

import json
import pathlib
import struct
import sys

# The file here, the file there, and the numbers of the episodes that are kept: even ones are of random actions.
EPISODES = {
    "treasure-4": ("ctc4", [0, 1]),
    "treasure-8": ("ctc8", [0, 1]),
    "treasure-12": ("ctc12", [1]),
    "rover-tower-8": ("rover_tower8", [0, 1, 2, 3]),
    "rover-tower-14": ("rover_tower14", [1]),
    "navigation-3": ("spread3", [0, 1, 2, 3]),
}

# The widths of what each agent sees.
KEPT = ["obs_dims"]


def select(source, episodes):
    """The bytes of a file of tensors with these episodes alone."""
    data = source.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header, tensors = json.loads(data[8 : 8 + length]), data[8 + length :]
    kept = {"__metadata__": {key: header["__metadata__"][key] for key in KEPT}}
    values = b""
    for name, tensor in header.items():
        if name != "__metadata__" and int(name[2:5]) in episodes:
            begin, end = tensor["data_offsets"]
            kept[name] = {**tensor, "data_offsets": [len(values), len(values) + end - begin]}
            values += tensors[begin:end]
    text = json.dumps(kept).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<Q", len(text)) + text + values


def main():
    folder, here = pathlib.Path(sys.argv[1]), pathlib.Path(__file__).parent
    for name, (source, episodes) in EPISODES.items():
        tensors = select(folder / f"{source}.safetensors", episodes)
        (here / f"{name}.safetensors").write_bytes(tensors)


if __name__ == "__main__":
    main()
