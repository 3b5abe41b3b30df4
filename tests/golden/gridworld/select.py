"""Keeps some of the recorded episodes: select.py FOLDER writes, beside this file, those named in EPISODES."""

import json
import pathlib
import struct
import sys

# The file, and the numbers of the episodes that are kept.
EPISODES = {f"task{task}_n{agents}": [0] for task in (1, 2, 3) for agents in (2, 3, 4)}
EPISODES |= {"task1_n2": [0, 1, 3], "flip_n2": [0], "flip_n4": [1]}
# The maps that are kept.
MAPS = [0, 1, 2, 3]
# What a central critic sees is made of what the agents see.
LEFT_OUT = {"state", "state_steps", "visit_counts"}


def select(source, episodes):
    """The bytes of a file of tensors with these episodes alone."""
    data = source.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header, tensors = json.loads(data[8 : 8 + length]), data[8 + length :]
    metadata = header.pop("__metadata__")
    told = json.loads(metadata["episodes"])
    kept = {"__metadata__": {**metadata, "episodes": json.dumps([told[number] for number in episodes])}}
    values = b""
    for name, tensor in sorted(header.items(), key=lambda item: item[1]["data_offsets"]):
        episode, own = name.split("/")
        if int(episode[2:]) in episodes and own not in LEFT_OUT:
            begin, end = tensor["data_offsets"]
            kept[name] = {**tensor, "data_offsets": [len(values), len(values) + end - begin]}
            values += tensors[begin:end]
    text = json.dumps(kept).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<Q", len(text)) + text + values


def main():
    folder, here = pathlib.Path(sys.argv[1]), pathlib.Path(__file__).parent
    for name, episodes in EPISODES.items():
        (here / f"{name}.safetensors").write_bytes(select(folder / f"{name}.safetensors", episodes))
    maps = json.loads((folder / "flip_maps.json").read_text())
    maps["maps"] = [maps["maps"][number] for number in MAPS]
    (here / "flip_maps.json").write_text(json.dumps(maps) + "\n")


if __name__ == "__main__":
    main()
