#!/bin/sh
# Makes all files again; the packages of requirements.txt take about 6 GB.
set -e
cd "$(dirname "$0")"
python3 -m venv "${1:?the folder of the virtual environment}"
# The exporter of Godot RL wants an older Stable-Baselines3 than it needs, simulators are needed by none.
"$1/bin/pip" install --no-deps -r requirements.txt
# ML-Agents wants an older Python than it needs, and an older numpy than the others.
python3.10 -m venv "$1/mlagents"
"$1/mlagents/bin/pip" install --no-deps --ignore-requires-python -r requirements-mlagents.txt
"$1/mlagents/bin/python" mlagents_files.py
for script in rsl_rl sb3 godot skrl torch quantised apart; do "$1/bin/python" "${script}_files.py"; done
