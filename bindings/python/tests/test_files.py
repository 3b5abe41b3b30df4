"""Files: what is opened, what is refused and in which words; and what runs meanwhile."""

import json
import os
import struct
import subprocess
import threading

import numpy as np
import pytest
import sortie
from conftest import assert_close, foreign, recorded
from sortie import _compiler


@pytest.fixture
def no_compiler(monkeypatch, tmp_path):
    monkeypatch.setattr(_compiler, "PROGRAM", tmp_path / "sortie-tools")


def plan_of(name, folder):
    path = folder / f"{name}.plan"
    sortie.compile(foreign(name), path)
    return path


def test_an_installation_without_compiler_runs_plans_and_says_what_it_lacks(tmp_path, monkeypatch):
    path = plan_of("sb3_dqn.classic", tmp_path)
    observation = recorded("sb3_dqn.classic")["in__observation"][0]
    want = sortie.Plan(foreign("sb3_dqn.classic"))(observation)
    monkeypatch.setattr(_compiler, "PROGRAM", tmp_path / "sortie-tools")
    assert sortie.Plan(path)(observation[0]).tobytes() == want.tobytes()
    for refused in (
        lambda: sortie.Plan(foreign("sb3_dqn.classic")),
        lambda: sortie.compile(foreign("sb3_dqn.classic"), tmp_path / "other.plan"),
        lambda: sortie.verify(foreign("sb3_dqn.classic"), "recorded.npz"),
    ):
        with pytest.raises(sortie.CompileError, match="sortie-tools` is missing, which reads ONNX files"):
            refused()


def test_a_shipped_team_needs_no_compiler(no_compiler, root):
    assert "group-matching" in repr(sortie.Bundle(root / "models" / "group-matching"))


def test_missing_files_are_as_everywhere(tmp_path):
    for opened in (sortie.Plan, lambda path: sortie.compile(path, tmp_path / "out.plan")):
        with pytest.raises(FileNotFoundError) as caught:
            opened(tmp_path / "none.onnx")
        assert caught.value.filename == str(tmp_path / "none.onnx")
    with pytest.raises(IsADirectoryError):
        sortie.Plan(tmp_path)
    with pytest.raises(sortie.BundleError, match="none"):
        sortie.Bundle(tmp_path / "none")
    with pytest.raises(OSError, match="nowhere"):
        sortie.compile(foreign("sb3_dqn.classic"), tmp_path / "nowhere" / "out.plan")


def test_files_are_named_or_read_before(tmp_path):
    path = plan_of("sb3_dqn.classic", tmp_path)
    for flawed in (5, None, path.open("rb")):
        with pytest.raises(TypeError, match="expected the path or the bytes of a plan or of an ONNX file"):
            sortie.Plan(flawed)


def test_broken_plans_are_refused(tmp_path):
    path = plan_of("sb3_dqn.classic", tmp_path)
    whole = path.read_bytes()
    end = whole.index(b"SORTIEAX")
    for length in (0, 7, 100, end - 64):
        path.write_bytes(whole[:length])
        with pytest.raises(sortie.PlanError, match=str(path)):
            sortie.Plan(path)
    damaged = bytearray(whole)
    damaged[end - 70] ^= 1
    with pytest.raises(sortie.PlanError):
        sortie.Plan(bytes(damaged))


def test_plans_of_other_networks_are_refused(root):
    with pytest.raises(sortie.PlanError, match=r"network agent.*`sortie.Bundle`"):
        sortie.Plan(root / "models" / "group-matching" / "agent.plan")


def test_a_plan_has_its_options_decided(tmp_path):
    path = plan_of("sb3_dqn.classic", tmp_path)
    for options in ({"profile": "fused"}, {"outputs": ["q"]}, {"sizes": {"N": 7}}, {"available": "none"}):
        with pytest.raises(ValueError, match="this is a plan"):
            sortie.Plan(path, **options)


def test_files_that_are_no_policies_are_refused_in_the_words_of_the_command_line(root):
    with pytest.raises(sortie.CompileError, match="the ONNX file cannot be read"):
        sortie.Plan(b"no model at all")
    name = foreign("torch_mha_own_query.classic")
    with pytest.raises(sortie.CompileError, match=rf"{name}: the size `N` of .* is left open.*--size N=7"):
        sortie.Plan(name)
    with pytest.raises(sortie.CompileError, match="the file has no output `action`, only"):
        sortie.Plan(foreign("sb3_dqn.classic"), outputs=["action"])
    for options, words in (
        ({"profile": "fast"}, "profile is `exact` or `fused`"),
        ({"profile": "int8"}, "judged by recorded observations"),
        ({"sizes": {"N": 0}}, "the size `N` is a whole number from 1"),
    ):
        with pytest.raises(ValueError, match=words):
            sortie.Plan(foreign("sb3_dqn.classic"), **options)


def test_a_fused_plan_says_so_and_answers_alike():
    exact, fused = (sortie.Plan(foreign("sb3_dqn.classic"), profile) for profile in ("exact", "fused"))
    assert (exact.inspect()["profile"], fused.inspect()["profile"]) == ("exact", "fused")
    observation = recorded("sb3_dqn.classic")["in__observation"][0]
    assert_close(fused(observation), exact(observation))


def test_an_int8_plan_of_the_command_line_is_opened(tmp_path):
    onnx, plan = foreign("epymarl_rnn.classic"), tmp_path / "int8.plan"
    # So few cases say too little to rely on it, which is what `--force` is for.
    judged = ["--profile", "int8", "--npz", onnx.with_suffix(".npz"), "--force", "--quiet"]
    subprocess.run([_compiler.program(), "compile", onnx, "-o", plan, *judged], check=True, capture_output=True)
    exact, int8 = sortie.Plan(onnx), sortie.Plan(plan)
    assert int8.inspect()["profile"] == "int8" and repr(int8) == repr(exact)
    observation = recorded("epymarl_rnn.classic")["in__obs"][0]
    differences = np.abs(int8(observation) - exact(observation))
    assert 0 < differences.max() < 0.05


def test_a_file_that_allocates_without_bound_ends_its_own_process_only(root):
    with pytest.raises(sortie.CompileError, match="the reader gave up|reading the ONNX file was given up"):
        sortie.Plan(root / "tests" / "hostile" / "allocates.onnx")


def test_threads_run_while_a_file_is_compiled(tmp_path, monkeypatch):
    # It answers once another thread of this program has written to a pipe, and gives up where none could.
    program, pipe = tmp_path / "sortie-tools", tmp_path / "pipe"
    os.mkfifo(pipe)
    program.write_text(f'#!/bin/sh\ncat >/dev/null\ntimeout 60 cat "{pipe}" >/dev/null || exit 4\nexit 3\n')
    program.chmod(0o755)
    monkeypatch.setattr(_compiler, "PROGRAM", program)
    thread = threading.Thread(target=lambda: pipe.write_text("go on"), daemon=True)
    thread.start()
    with pytest.raises(sortie.CompileError, match="ended with code 3"):
        sortie.Plan(foreign("sb3_dqn.classic"))
    thread.join()


def test_several_threads_ask_one_plan():
    plan = sortie.Plan(foreign("sb3_dqn.classic"))
    observations = recorded("sb3_dqn.classic")["in__observation"]
    want = plan.decide_batch(observations).tolist()
    found = {}

    def ask(number):
        many = [plan.decide_batch(observations).tolist() for _ in range(20)]
        found[number] = [[plan.decide(seen) for seen in observations], *many]

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(answers == want for number in found.values() for answers in number)
    assert len(found) == 4


def test_verify_compares_with_recorded_answers(tmp_path):
    npz = foreign("sb3_dqn.classic").with_suffix(".npz")
    report = sortie.verify(foreign("sb3_dqn.classic"), npz)
    names = [engine["name"] for engine in report["engines"]]
    assert names == [f"{engine} against recorded" for engine in ("plan", "tract", "onnxruntime")]


def test_verify_raises_where_answers_differ_and_keeps_the_report(tmp_path):
    arrays = recorded("sb3_dqn.classic")
    arrays["out__q"][5, 0, 0] += 1
    np.savez(tmp_path / "other.npz", **arrays)
    with pytest.raises(sortie.DifferenceError, match="plan against recorded, q") as caught:
        sortie.verify(foreign("sb3_dqn.classic"), tmp_path / "other.npz")
    assert caught.value.report["engines"][0]["max_rel_error"] > 0.1
    with pytest.raises(sortie.CompileError, match="none.npz"):
        sortie.verify(foreign("sb3_dqn.classic"), tmp_path / "none.npz")
    with pytest.raises(sortie.CompileError, match="--size N=7"):
        sortie.verify(foreign("torch_mha_own_query.classic"), tmp_path / "other.npz")


def test_inspect_tells_what_a_plan_is():
    report = sortie.Plan(foreign("sb3_recurrent_ppo.classic")).inspect()
    assert report["network"] == "policy" and report["profile"] == "exact"
    assert report["hidden"] == 128 and report["flash_bytes"] > 50_000
    states = report["policy"]["facts"]["states"]
    assert [(state["input"], state["output"], state["length"]) for state in states] == [
        ("h", "h_out", 64),
        ("c", "c_out", 64),
    ]


def test_a_plan_without_its_names_decides_alike(tmp_path):
    whole = plan_of("sb3_recurrent_ppo.classic", tmp_path).read_bytes()
    bare = sortie.Plan(whole[: whole.index(b"SORTIEAX")])
    assert repr(bare) == "<sortie.Plan input_0 [8], state [128] -> output_0 [5]>"
    named = sortie.Plan(whole)
    for observation in recorded("sb3_recurrent_ppo.classic")["in__observation"][:8, 0]:
        assert bare(observation).tobytes() == named(observation).tobytes()
        assert bare.decide(observation) == named.decide(observation)
    assert bare.inspect()["policy"]["facts"]["inputs"][0]["name"] == "input_0"


def crc32c(text):
    value = 0xFFFFFFFF
    for byte in text:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
    return value ^ 0xFFFFFFFF


def renamed(plan, edit):
    """The plan with other names, sizes and roles behind it."""
    end = plan.index(b"SORTIEAX")
    annex = json.loads(plan[end + 16 : plan.index(b"SORTIERO")])
    edit(annex["facts"])
    text = json.dumps(annex).encode()
    return plan[: end + 8] + struct.pack("<II", len(text), crc32c(text)) + text


def test_names_may_be_others(tmp_path):
    def edit(facts):
        facts["inputs"][0]["name"] = "what is seen"

    plan = renamed(plan_of("sb3_dqn.classic", tmp_path).read_bytes(), edit)
    assert repr(sortie.Plan(plan)) == "<sortie.Plan what is seen [1, 8] -> q [1, 5]>"


@pytest.mark.parametrize(
    "edit",
    [
        lambda facts: facts["inputs"][0].update(shape=[1, 41]),
        lambda facts: facts["inputs"][0].update(shape=[2**40, 2**40]),
        lambda facts: facts["inputs"][0].update(role="state"),
        lambda facts: facts["inputs"].append(facts["inputs"][0]),
        lambda facts: facts["outputs"][0].update(shape=[1, 8]),
        lambda facts: facts["outputs"][0].update(kind="i64"),
        lambda facts: facts["outputs"][0].update(role={"discrete": 4}),
        lambda facts: facts["outputs"][0].update(role={"discrete": 0}),
        lambda facts: facts["outputs"][0].update(role={"discrete": 2**63}, kind="i64"),
        lambda facts: facts["outputs"].pop(0),
        lambda facts: facts["states"][0].update(length=63),
        lambda facts: facts["states"].clear(),
    ],
)
def test_names_that_are_another_plans_are_refused(edit, tmp_path):
    plan = plan_of("epymarl_rnn.classic", tmp_path).read_bytes()
    with pytest.raises(sortie.PlanError, match="the names behind the plan cannot be read: they are another plan's"):
        sortie.Plan(renamed(plan, edit))
    with pytest.raises(sortie.PlanError, match="it is cut off or changed"):
        sortie.Plan(plan[: plan.index(b"SORTIERO") - 3])


def test_a_robots_facts_stand_in_the_plan(root):
    written = root / "tests" / "golden" / "onnx-written"
    robot = sortie.Plan(written / "mjlab_velocity.plan").robot
    assert robot["joint_names"][3] == "knee" and robot["normaliser"] == "file"
    assert np.allclose(robot["default_joint_pos"][2], -0.312) and len(robot["stiffness"]) == 6
    assert sortie.Plan(written / "sb3_ppo.onnx", outputs=["actions"]).robot["normaliser"] == "none"
