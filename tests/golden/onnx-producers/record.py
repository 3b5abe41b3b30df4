"""Records what onnxruntime answers to random inputs of a file, beside that file."""

import pathlib

import numpy
import onnx
import onnxruntime
import torch

FOLDER = pathlib.Path(__file__).parent
OPSET = {False: 17, True: 18}
NAMES = {False: "classic", True: "dynamo"}
TYPES = {
    "tensor(float)": numpy.float32,
    "tensor(double)": numpy.float64,
    "tensor(int64)": numpy.int64,
    "tensor(int32)": numpy.int32,
    "tensor(uint8)": numpy.uint8,
    "tensor(bool)": numpy.bool_,
}


def path(name):
    return str(FOLDER / f"{name}.onnx")


def masks(generator, shape):
    """Masks of available actions: at least one is."""
    mask = generator.random(shape) < 0.6
    mask[..., 0] |= ~mask.any(-1)
    return mask


def numbers(generator, shape, kind):
    if kind == numpy.bool_:
        return masks(generator, shape)
    if kind == numpy.uint8:
        return generator.integers(0, 256, shape, kind)
    return generator.normal(size=shape).astype(kind)


def record(name, cases=64, sizes=None, outputs=None, **made):
    """Writes NAME.npz: all outputs, or those named; `made` makes the inputs of their names, as generator, shape and type say."""
    file = path(name)
    onnx.checker.check_model(file)
    session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])
    generator = numpy.random.default_rng(len(name))
    recorded = {}
    for _ in range(cases):
        given = {}
        for value in session.get_inputs():
            shape = [size if isinstance(size, int) else (sizes or {}).get(size, 1) for size in value.shape]
            given[value.name] = made.get(value.name, numbers)(generator, shape, TYPES[value.type])
        outputs = outputs or [value.name for value in session.get_outputs()]
        for key, value in given.items():
            recorded.setdefault(f"in__{key}", []).append(value)
        for key, value in zip(outputs, session.run(outputs, given)):
            recorded.setdefault(f"out__{key}", []).append(value)
    stacked = {key: numpy.stack(values) for key, values in recorded.items()}
    numpy.savez(FOLDER / f"{name}.npz", **stacked)
    print(f"{name}: {sorted(session.get_modelmeta().custom_metadata_map)}")


def both(name, module, inputs, names, outputs, exporters=(False, True), **options):
    """Exports a module with both of PyTorch's exporters, and records both files."""
    of_cases = {key: options.pop(key) for key in ("cases", "sizes", "made") if key in options}
    made = of_cases.pop("made", {})
    for dynamo in exporters:
        file = f"{name}.{NAMES[dynamo]}"
        arguments = dict(options)
        if dynamo and "dynamic_axes" in arguments:
            del arguments["dynamic_axes"]
        arguments.setdefault("opset_version", OPSET[dynamo])
        try:
            with torch.no_grad():
                torch.onnx.export(
                    module.eval(),
                    inputs,
                    path(file),
                    input_names=names,
                    output_names=outputs,
                    dynamo=dynamo,
                    **({"external_data": False} if dynamo else {}),
                    **arguments,
                )
        except (torch.onnx.errors.OnnxExporterError, RuntimeError) as error:
            print(f"{file}: not exported: {str(error).splitlines()[0]}")
            continue
        record(file, **of_cases, **made)
