"""Writes a network with 8-bit weights and activations quantised call by call, as onnxruntime offers it.

    python3 quantise.py NETWORK.onnx QUANTISED.onnx

Needs the packages onnxruntime and onnx.
"""

import logging
import sys

from onnxruntime.quantization import QuantType, quantize_dynamic

logging.disable(logging.WARNING)
network, quantised = sys.argv[1:]
quantize_dynamic(network, quantised, weight_type=QuantType.QInt8)
