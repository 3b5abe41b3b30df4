"""The agents' update of preset `fast` in PyTorch: the peer of `sortie bench train`.

One thread, fused Adam, records padded or packed. The features of the records come ready-made, dense and padded, as a replay of tensors gives them: making them is not part of the
measured time, packing them is.

Called as `train_step.py FILE`. FILE is a safetensors file with the networks, batches of records, and for
the first batch the loss and the gradient to compare with. Prints a line of JSON with the comparison;
then, for every line `FORMULATION SECONDS` on standard input, updates for so long and prints
`{"updates": N, "cpu_s": S}`.
"""

import json
import struct
import sys
import time

import torch
import torch.nn.functional as F

TYPES = {"F32": torch.float32, "I64": torch.int64, "BOOL": torch.bool}
BATCH = ["rows", "present", "actions", "reward", "discount", "next_rows", "next_available"]


def read(path):
    """The tensors and the metadata of a safetensors file."""
    with open(path, "rb") as file:
        data = bytearray(file.read())
    start = 8 + struct.unpack("<Q", data[:8])[0]
    header = json.loads(bytes(data[8:start]))
    metadata = header.pop("__metadata__")
    tensors = {}
    for name, entry in header.items():
        first, end = entry["data_offsets"]
        part = data[start + first : start + end]
        tensors[name] = torch.frombuffer(part, dtype=TYPES[entry["dtype"]]).view(entry["shape"])
    return tensors, {key: float(value) for key, value in metadata.items()}


class Padded:
    """Records as [N, T + 1, D]: the team's agents, padded, then the building."""

    def __init__(self, batch):
        present = batch["present"]
        self.rows, self.next_rows = batch["rows"], batch["next_rows"]
        self.present = present.float()
        visible = torch.cat([present, torch.ones_like(present[:, :1])], 1)
        self.visible = visible[:, None, None, :]
        self.actions = batch["actions"][..., None]
        # Padding may do anything, so that no row is without an action.
        self.unavailable = ~(batch["next_available"] | ~present[..., None])

    def utilities(self, w, heads, rows):
        n, entities, _ = rows.shape
        embedding = F.relu(F.linear(rows, w["fc1.weight"], w["fc1.bias"]))
        q_weight, kv_weight = w["attention.in.weight"].split([embedding.shape[-1], 2 * embedding.shape[-1]])
        q = F.linear(embedding[:, :-1], q_weight).view(n, entities - 1, heads, -1).transpose(1, 2)
        kv = F.linear(embedding, kv_weight).view(n, entities, 2, heads, -1).permute(2, 0, 3, 1, 4)
        scores = (q @ kv[0].transpose(-1, -2)) * q.shape[-1] ** -0.5
        weights = scores.masked_fill(~self.visible, -torch.inf).softmax(-1)
        attended = (weights @ kv[1]).transpose(1, 2).reshape(n, entities - 1, -1)
        return head(w, attended, embedding[:, :-1])

    def sum(self, values):
        return (values * self.present).sum(1)


class Packed:
    """The existing agents of all records in one list, then the buildings; attention by gathering."""

    def __init__(self, batch):
        present = batch["present"]
        n, team = present.shape
        agents = int(present.sum())
        pack = lambda rows: torch.cat([rows[:, :-1][present], rows[:, -1]])
        self.rows, self.next_rows = pack(batch["rows"]), pack(batch["next_rows"])
        number = torch.zeros(n, team, dtype=torch.int64)
        number[present] = torch.arange(agents)
        lists = torch.cat([number, agents + torch.arange(n)[:, None]], 1)
        seen = torch.cat([present, torch.ones(n, 1, dtype=torch.bool)], 1)
        self.record = torch.arange(n)[:, None].expand(n, team)[present]
        self.lists, self.visible = lists[self.record], seen[self.record][:, None, :]
        self.records, self.agents = n, agents
        self.actions = batch["actions"][present][:, None]
        self.unavailable = ~batch["next_available"][present]

    def utilities(self, w, heads, rows):
        embedding = F.relu(F.linear(rows, w["fc1.weight"], w["fc1.bias"]))
        q_weight, kv_weight = w["attention.in.weight"].split([embedding.shape[-1], 2 * embedding.shape[-1]])
        q = F.linear(embedding[: self.agents], q_weight).view(self.agents, heads, 1, -1)
        kv = F.linear(embedding, kv_weight).index_select(0, self.lists.flatten())
        k, v = kv.view(self.agents, self.lists.shape[1], 2, heads, -1).permute(2, 0, 3, 1, 4)
        scores = (q @ k.transpose(-1, -2))[:, :, 0] * q.shape[-1] ** -0.5
        weights = scores.masked_fill(~self.visible, -torch.inf).softmax(-1)
        return head(w, (weights[:, :, None] @ v).reshape(self.agents, -1), embedding[: self.agents])

    def sum(self, values):
        return torch.zeros(self.records).index_add(0, self.record, values)


FORMULATIONS = {"padded": Padded, "packed": Packed}


def head(w, attended, own):
    looked = F.linear(attended, w["attention.out.weight"], w["attention.out.bias"])
    if "skip.weight" in w:
        looked = looked + F.linear(own, w["skip.weight"])
    looked = F.relu(looked)
    base = F.relu(F.linear(looked, w["fc2.weight"], w["fc2.bias"]))
    return F.linear(base, w["head.weight"], w["head.bias"])


class Learner:
    def __init__(self, tensors, settings):
        part = lambda of: {k[len(of) :]: v.clone() for k, v in tensors.items() if k.startswith(of)}
        self.online, self.target, self.average = part("online."), part("target."), part("online.")
        for weight in self.online.values():
            weight.requires_grad_()
        self.weights = list(self.online.values())
        self.settings, self.heads = settings, int(settings["heads"])
        self.adam = torch.optim.Adam(
            self.weights, lr=settings["learning_rate"], eps=settings["epsilon"], fused=True
        )

    def loss(self, formulation, batch):
        """Double Q-learning on the sum of the team's utilities."""
        with torch.no_grad():
            form = formulation(batch)
            liked = form.utilities(self.online, self.heads, form.next_rows)
            best = liked.masked_fill(form.unavailable, -torch.inf).argmax(-1, keepdim=True)
            values = form.utilities(self.target, self.heads, form.next_rows)
            value = form.sum(values.gather(-1, best).squeeze(-1))
            wanted = batch["reward"] + batch["discount"] * value
        utilities = form.utilities(self.online, self.heads, form.rows)
        value = form.sum(utilities.gather(-1, form.actions).squeeze(-1))
        return F.mse_loss(value, wanted)

    def update(self, formulation, batch):
        self.adam.zero_grad()
        self.loss(formulation, batch).backward()
        torch.nn.utils.clip_grad_norm_(self.weights, self.settings["clip"])
        self.adam.step()
        with torch.no_grad():
            online = [weight.detach() for weight in self.weights]
            torch._foreach_lerp_(list(self.target.values()), online, self.settings["target_rate"])
            torch._foreach_lerp_(list(self.average.values()), online, self.settings["average_rate"])

    def compare(self, formulation, batch, tensors):
        """Loss, gradient norm, and the relative distance of the gradient from the given one."""
        self.adam.zero_grad()
        loss = self.loss(formulation, batch)
        loss.backward()
        got = torch.cat([weight.grad.flatten() for weight in self.weights])
        want = torch.cat([tensors["gradient." + name].flatten() for name in self.online])
        return {
            "loss": loss.item(),
            "gradient_norm": got.norm().item(),
            "gradient_error": ((got - want).norm() / want.norm()).item(),
        }


def run(learner, formulation, batches, seconds):
    start, updates = time.process_time(), 0
    while time.process_time() - start < seconds:
        learner.update(formulation, batches[updates % len(batches)])
        updates += 1
    return updates, time.process_time() - start


def main():
    torch.set_num_threads(1)
    torch.manual_seed(0)
    tensors, settings = read(sys.argv[1])
    batches = [
        {name: tensors[f"batch{number}.{name}"] for name in BATCH}
        for number in range(int(settings["batches"]))
    ]
    ready = {"torch": torch.__version__}
    for name, formulation in FORMULATIONS.items():
        ready[name] = Learner(tensors, settings).compare(formulation, batches[0], tensors)
    learners = {name: Learner(tensors, settings) for name in FORMULATIONS}
    print(json.dumps(ready), flush=True)
    for line in sys.stdin:
        name, seconds = line.split()
        updates, cpu_s = run(learners[name], FORMULATIONS[name], batches, float(seconds))
        print(json.dumps({"updates": updates, "cpu_s": cpu_s}), flush=True)


if __name__ == "__main__":
    main()
