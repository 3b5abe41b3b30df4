"""Both levels' steps of preset `paper` in PyTorch: the peer of `sortie bench train --preset paper`.

One thread, two formulations. `padded` is structured as the public code is: every entity asks for attention,
every subtask has its own masked copy of the mixing weights and its own update, every proposal is computed
whole. `lean` computes only what the loss depends on, as far as large tensors allow: rows that somebody looks
at, queries of agents, teams in one list, the update of the chosen subtask, distinct proposals for the critic.
Features, masks and lists come ready-made: making them is not part of the measured time.

Called as `published_step.py FILE`. FILE is a safetensors file with networks, a batch, the noise of the
proposals, and gradients to compare with. Prints a line of JSON with the comparison; then, for every line
`FORMULATION LEVEL` on standard input, takes one step and prints `{"cpu_s": S}`.
"""

import json
import struct
import sys
import time

import torch
import torch.nn.functional as F

TYPES = {"F32": torch.float32, "I64": torch.int64, "BOOL": torch.bool}
HYPERNETWORKS = ["w1", "b1", "w2", "v"]
NEVER = -1e30


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


def one_hot(numbers, count):
    """Rows of zeros for -1."""
    return (numbers[..., None] == torch.arange(count)).float()


def attend(q, k, v, allowed):
    """Queries `[.., H, Q, h]` over keys and values `[.., H, N, h]`, heads joined: `[.., Q, E]`."""
    scores = (q @ k.transpose(-1, -2)) * q.shape[-1] ** -0.5
    weights = scores.masked_fill(~allowed, NEVER).softmax(-1)
    return (weights @ v).transpose(-2, -3).flatten(-2)


def attend_all(w, of, x, allowed, queries, heads):
    """Attention of the first rows of `x [n, N, E]`; projections of all rows, as the public code has them."""
    n, entities, _ = x.shape
    projected = F.linear(x, w[of + "attention.in.weight"]).view(n, entities, 3, heads, -1)
    q, k, v = projected.permute(2, 0, 3, 1, 4)
    attended = attend(q[:, :, :queries], k, v, allowed[:, None])
    return F.linear(attended, w[of + "attention.out.weight"], w[of + "attention.out.bias"])


def utilities(w, attended, own):
    """The agents' utilities from what their attention gives, and their own embeddings where those skip it."""
    if "agents.skip.weight" in w:
        attended = attended + F.linear(own, w["agents.skip.weight"])
    base = F.relu(F.linear(F.relu(attended), w["agents.fc2.weight"], w["agents.fc2.bias"]))
    return F.linear(base, w["agents.head.weight"], w["agents.head.bias"])


class PopArt:
    """Statistics of targets, and the head that they rescale."""

    def __init__(self, mean, variance):
        self.mean, self.variance = mean, variance

    def real(self, value):
        return value * self.variance**0.5 + self.mean

    def update(self, targets, mask, weight, bias):
        """Moves the statistics and returns the normalised targets."""
        total = mask.sum() + 1e-8
        distance = targets - self.mean
        old_mean, old = self.mean, self.variance**0.5
        self.mean = old_mean + 0.01 * ((distance * mask).sum() / total).item()
        square = ((distance**2 * mask).sum() / total).item()
        self.variance = max(0.99 * (self.variance + 0.01 * square), 1e-4)
        new = self.variance**0.5
        with torch.no_grad():
            weight.mul_(old / new)
            bias.mul_(old / new).add_((old_mean - self.mean) / new)
        return (targets - self.mean) / new


class Scene:
    """Some states as the low level sees them: entities of one step, subtasks of the same or another."""

    def __init__(self, data, entities_of, tasks_of):
        agents, tasks = data.agents, data.tasks
        self.x = data.x[entities_of]
        present = data.present[entities_of]
        task = data.entity_task[tasks_of].masked_fill(~present, -1)
        self.task, self.present = task, present
        together = (task[:, :agents, None] == task[:, None]) & (task[:, None] >= 0)
        self.mixed = together
        self.seen = together & data.observable[entities_of] & present[:, None]
        self.member = one_hot(task[:, :agents], tasks).transpose(1, 2)


class PaddedLow:
    """Everything of everybody, then masks."""

    def __init__(self, data):
        every = torch.arange(data.states).view(-1, data.steps)
        self.now, self.next = every[:, :-1].flatten(), every[:, 1:].flatten()
        self.all = Scene(data, every.flatten(), every.flatten())
        self.current = Scene(data, self.now, self.now)
        self.later = Scene(data, self.next, self.now)
        self.actions = data.actions[self.now][..., None]
        self.unavailable = ~data.available[self.next]
        # Who is absent may do anything.
        self.unavailable &= self.later.present[:, : data.agents, None]
        self.mask = data.terms[self.now].float()
        self.reward = data.task_reward[self.now]
        self.goes_on = 1.0 - data.task_terminated[self.now].float()
        self.agents, self.heads = data.agents, data.heads

    def utilities(self, w, scene):
        x = F.relu(F.linear(scene.x, w["agents.fc1.weight"], w["agents.fc1.bias"]))
        attended = attend_all(w, "agents.", x, scene.seen, self.agents, self.heads)
        return utilities(w, attended, x[:, : self.agents])

    def hypernetwork(self, w, name, scene):
        x = F.relu(F.linear(scene.x, w[name + ".fc1.weight"], w[name + ".fc1.bias"]))
        attended = attend_all(w, name + ".", x, scene.mixed, self.agents, self.heads)
        return F.linear(attended, w[name + ".fc2.weight"], w[name + ".fc2.bias"])

    def mix(self, w, scene, chosen):
        """Values `[n, T]` before the head."""
        w1, b1, w2, v = (self.hypernetwork(w, name, scene) for name in HYPERNETWORKS)
        member = scene.member[..., None]
        w1 = w1.softmax(-1)[:, None] * member
        b1, w2, v = ((given[:, None] * member).mean(2) for given in (b1, w2, v))
        hidden = F.elu((chosen[:, None, None] @ w1)[:, :, 0] + b1)
        return (w2.softmax(-1) * hidden).sum(-1) + v.mean(-1)

    def find(self, online, target):
        """Values of the taken actions with gradients, and of the next state."""
        by_state = self.utilities(online, self.all)
        chosen = by_state[self.now].gather(-1, self.actions)[..., 0]
        chosen = chosen * self.current.present[:, : self.agents]
        with torch.no_grad():
            liked = by_state[self.next].masked_fill(self.unavailable, NEVER)
            best = liked.argmax(-1, keepdim=True)
            later = self.utilities(target, self.later).gather(-1, best)[..., 0]
            later = later * self.later.present[:, : self.agents]
            worth = self.mix(target, self.later, later)
        return self.mix(online, self.current, chosen), worth


class Packed:
    """The rows of some states that count, and the agents among them, in lists."""

    def __init__(self, scene, used, agents):
        """`used [n, T]`: the subtasks whose teams count."""
        task = scene.task
        counts = (task >= 0) & used.gather(1, task.clamp(min=0))
        n, entities = task.shape
        rows = counts.flatten().nonzero()[:, 0]
        self.x = scene.x.flatten(0, 1)[rows]
        # Where every row of the padded layout comes from; those that do not count from one behind the last.
        self.grid = torch.full((n * entities,), len(rows))
        self.grid[rows] = torch.arange(len(rows))
        own = counts[:, :agents]
        self.own = own.flatten().nonzero()[:, 0]
        self.own_rows = self.grid.view(n, entities)[:, :agents][own]
        self.own_grid = torch.full((n * agents,), len(self.own))
        self.own_grid[self.own] = torch.arange(len(self.own))
        self.states, self.seen, self.mixed = n, scene.seen, scene.mixed
        # Teams in the order of states and subtasks.
        number_of_team = (used.flatten().cumsum(0) - 1).view(used.shape)
        self.teams = int(used.sum())
        states = torch.arange(n)[:, None].expand(n, agents)[own]
        self.team = number_of_team[states, task[:, :agents][own]]

    def attend(self, w, of, x, allowed, heads):
        """Attention of all listed agents over `x [rows, E]`, before the output projection."""
        width = x.shape[-1]
        queries, keys_values = w[of + "attention.in.weight"].split([width, 2 * width])
        q = F.pad(F.linear(x[self.own_rows], queries), (0, 0, 0, 1))[self.own_grid]
        kv = F.pad(F.linear(x, keys_values), (0, 0, 0, 1))[self.grid]
        q = q.view(self.states, -1, heads, width // heads).transpose(1, 2)
        k, v = kv.view(self.states, -1, 2, heads, width // heads).permute(2, 0, 3, 1, 4)
        return attend(q, k, v, allowed[:, None]).flatten(0, 1)[self.own]


class LeanLow:
    """Only teams that enter the loss."""

    def __init__(self, data):
        self.heads, self.agents = data.heads, data.agents
        states = torch.arange(data.states)
        whole = Scene(data, states, states)
        now = data.terms.any(1).nonzero()[:, 0]
        terms = data.terms[now]
        current, later = Scene(data, now, now), Scene(data, now + 1, now)
        self.current = Packed(current, terms, data.agents)
        goes_on = terms & ~data.task_terminated[now]
        self.later = Packed(later, goes_on, data.agents)
        # Agents of the next state, as they are allocated there.
        task, before = whole.task[:, : data.agents], later.task[:, : data.agents]
        heirs = (before >= 0) & goes_on.gather(1, before.clamp(min=0)) & (task[now + 1] >= 0)
        used = data.terms.clone()
        place, agent = heirs.nonzero(as_tuple=True)
        used[now[place] + 1, task[now[place] + 1, agent]] = True
        self.all = Packed(whole, used, data.agents)
        number = torch.full((data.states, data.agents), -1)
        number.view(-1)[self.all.own] = torch.arange(len(self.all.own))
        self.own_now = number[now].flatten()[self.current.own]
        self.own_next = number[now + 1].flatten()[self.later.own]
        self.actions = data.actions[now].flatten()[self.current.own][:, None]
        self.unavailable = ~data.available[now + 1].flatten(0, 1)[self.later.own]
        self.bootstrapped = goes_on[terms]
        self.reward = data.task_reward[now][terms]
        # A value without a future has none to discount.
        self.goes_on, self.mask = self.bootstrapped.float(), torch.ones_like(self.reward)

    def utilities(self, w, packed):
        x = F.relu(F.linear(packed.x, w["agents.fc1.weight"], w["agents.fc1.bias"]))
        attended = packed.attend(w, "agents.", x, packed.seen, self.heads)
        attended = F.linear(attended, w["agents.attention.out.weight"], w["agents.attention.out.bias"])
        return utilities(w, attended, x[packed.own_rows])

    def mix(self, w, packed, chosen):
        """Values of all teams before the head. Means are taken before the projections that follow them."""
        each = lambda part: torch.cat([w[name + part] for name in HYPERNETWORKS])
        x = F.relu(F.linear(packed.x, each(".fc1.weight"), each(".fc1.bias")))
        attended = [
            packed.attend(w, name + ".", own, packed.mixed, self.heads)
            for name, own in zip(HYPERNETWORKS, x.chunk(4, -1))
        ]
        share = torch.bincount(packed.team, minlength=packed.teams)[:, None] / self.agents

        def project(name, given, share):
            out = F.linear(given, w[name + ".attention.out.weight"])
            out = out + share * w[name + ".attention.out.bias"]
            return F.linear(out, w[name + ".fc2.weight"]) + share * w[name + ".fc2.bias"]

        w1 = project("w1", attended[0], 1.0).softmax(-1)
        mean = lambda given: torch.zeros(packed.teams, given.shape[-1]).index_add(
            0, packed.team, given / self.agents
        )
        b1, w2, v = (
            project(name, mean(given), share) for name, given in zip(HYPERNETWORKS[1:], attended[1:])
        )
        mixed = torch.zeros_like(b1).index_add(0, packed.team, w1 * chosen[:, None])
        return (w2.softmax(-1) * F.elu(mixed + b1)).sum(-1) + v.mean(-1)

    def find(self, online, target):
        by_agent = self.utilities(online, self.all)
        chosen = by_agent[self.own_now].gather(-1, self.actions)[:, 0]
        with torch.no_grad():
            liked = by_agent[self.own_next].masked_fill(self.unavailable, NEVER)
            best = liked.argmax(-1, keepdim=True)
            later = self.utilities(target, self.later).gather(-1, best)[:, 0]
            worth = torch.zeros_like(self.reward)
            worth[self.bootstrapped] = self.mix(target, self.later, later)
        return self.mix(online, self.current, chosen), worth


class Batch:
    """Windows as dense tensors `[W S, ..]`."""

    def __init__(self, tensors, settings):
        part = lambda name: tensors["batch." + name]
        self.steps, self.heads = int(settings["steps"]), int(settings["heads"])
        self.features, self.present = part("features"), part("present")
        self.observable, self.entity_task = part("observable"), part("entity_task")
        self.available, self.actions = part("available"), part("actions")
        self.task_reward, self.task_terminated = part("task_reward"), part("task_terminated")
        self.states, self.agents, actions = self.available.shape
        self.tasks = self.task_reward.shape[1]
        last = torch.zeros(*self.present.shape, actions)
        last[:, : self.agents] = one_hot(part("last_actions"), actions)
        self.x = torch.cat([self.features, last], -1)
        task = self.entity_task.masked_fill(~self.present, -1)[:, : self.agents]
        self.terms = part("task_unfinished") & (one_hot(task, self.tasks).sum(1) > 0)
        self.terms &= part("has_transition")[:, None]


class LowLevel:
    """Agents and mixer; a step on a batch."""

    def __init__(self, tensors, settings, batch, formulation):
        self.online, self.target = take(tensors, "online."), take(tensors, "target.")
        self.popart = PopArt(settings["mean"], settings["variance"])
        self.bootstrap = PopArt(settings["target_mean"], settings["target_variance"])
        self.settings, self.form = settings, formulation(batch)
        self.optimiser = optimiser(self.online, settings)

    def loss(self):
        form, online = self.form, self.online
        value, worth = form.find(online, self.target)
        worth = worth * self.target["head.weight"] + self.target["head.bias"]
        wanted = form.reward + self.settings["discount"] * form.goes_on * self.bootstrap.real(worth)
        weight, bias = online["head.weight"], online["head.bias"]
        wanted = self.popart.update(wanted, form.mask, weight, bias)
        error = (value * weight + bias - wanted) * form.mask
        return {"online": (error**2).sum() / form.mask.sum()}

    def step(self):
        descend(self.loss(), [self.online], [self.optimiser], self.settings["clip"])


class Decisions:
    """The states in which agents were allocated."""

    def __init__(self, tensors, settings, batch):
        at = tensors["rows.state"]
        self.features, self.present = batch.features[at], batch.present[at]
        self.open, self.agents, self.tasks = tensors["rows.open"], batch.agents, batch.tasks
        task = batch.entity_task[at]
        self.own = self.present[:, : batch.agents]
        self.stored = task[:, : batch.agents].masked_fill(~self.own, -1)
        self.last = tensors["rows.last_allocation"]
        self.others = one_hot(task[:, batch.agents :], batch.tasks)
        together = (task[:, batch.agents :, None] == task[:, None, batch.agents :]) & (
            task[:, None, batch.agents :] >= 0
        )
        exist = self.present[:, batch.agents :]
        self.together = together & exist[:, None] & exist[:, :, None]
        self.exist = exist.float()[..., None]
        self.reward, self.mask = tensors["rows.reward"], tensors["rows.mask"].float()
        self.goes_on = 1.0 - tensors["rows.terminated"].float()
        self.weight = self.mask * tensors["rows.weight"]
        self.columns = {name: tensors["columns." + name] for name in ["policy", "critic", "stored", "target"]}
        self.heads, self.proposals = batch.heads, int(settings["proposals"])


class Critic:
    """Values of allocations `[R, K, A]`, before the head."""

    def __init__(self, rows):
        self.rows = rows

    def value(self, w, allocations, columns, row=None):
        """`row` names the decision of every allocation where there is one allocation in each of many rows."""
        r = self.rows
        pick = (lambda given: given) if row is None else (lambda given: given[row])
        g = F.linear(r.features, w["entity.weight"], w["entity.bias"])
        given = torch.cat(
            [
                one_hot(allocations, r.tasks),
                pick(r.others)[:, None].expand(-1, allocations.shape[1], -1, -1),
            ],
            2,
        )
        counts = torch.stack([given[:, :, : r.agents].sum(2), given[:, :, r.agents :].sum(2)], -1)
        teams = 0.2 * F.linear(counts, w["count.weight"], w["count.bias"])
        teams = teams + w["task.weight"].t()[r.columns[columns]]
        x = F.relu(pick(g)[:, None] + given @ teams).flatten(0, 1)
        present = pick(r.present)[:, None].expand(-1, allocations.shape[1], -1).flatten(0, 1)
        y = self.looked(w, x, present)
        own = present[:, : r.agents, None]
        mean = (F.relu(y) * own).sum(1) / r.agents
        return F.linear(mean, w["value.weight"], w["value.bias"]).view(allocations.shape[:2])

    def looked(self, w, x, present):
        return attend_all(w, "", x, present[:, None], self.rows.agents, self.rows.heads)

    def best(self, w, allocations):
        """The value of every proposal."""
        return self.value(w, allocations, "critic")


class LeanCritic(Critic):
    """Queries of agents only; each distinct proposal once."""

    def looked(self, w, x, present):
        width, heads, n = x.shape[-1], self.rows.heads, len(x)
        q, kv = w["attention.in.weight"].split([width, 2 * width])
        q = F.linear(x[:, : self.rows.agents], q).view(n, self.rows.agents, heads, -1).transpose(1, 2)
        k, v = F.linear(x, kv).view(n, x.shape[1], 2, heads, -1).permute(2, 0, 3, 1, 4)
        attended = attend(q, k, v, present[:, None, None])
        return F.linear(attended, w["attention.out.weight"], w["attention.out.bias"])

    def best(self, w, allocations):
        r = self.rows
        digits = (r.tasks + 1) ** torch.arange(r.agents)
        codes = ((allocations + 1) * digits).sum(-1)
        codes += torch.arange(len(codes))[:, None] * int((r.tasks + 1) ** r.agents)
        distinct, inverse = codes.unique(return_inverse=True)
        row = distinct // int((r.tasks + 1) ** r.agents)
        unpacked = distinct[:, None] // digits % (r.tasks + 1) - 1
        return self.value(w, unpacked[:, None], "critic", row)[:, 0][inverse]


class Policy:
    """Proposes allocations `[R, P, A]`, with log-probabilities and entropies `[R, P]`."""

    def __init__(self, rows):
        self.rows = rows

    def begin(self, w):
        """Agents `[R, A, E]`, subtasks `[R, T, E]` and their entities `[R, T]`."""
        r = self.rows
        marks = w["task.weight"].t()[r.columns["policy"]]
        z = F.linear(r.features, w["entity.weight"], w["entity.bias"])
        agents = z[:, : r.agents] + one_hot(r.last, r.tasks) @ marks
        others = F.relu(z[:, r.agents :] + r.others @ marks)
        others = attend_all(w, "", others, r.together, others.shape[1], r.heads) * r.exist
        return agents, r.others.transpose(1, 2) @ others, 0.2 * r.others.sum(1)

    def propose(self, w, noise):
        r = self.rows
        agents, g, counts = self.begin(w)
        shape = len(g), r.proposals, r.tasks
        g = g[:, None].expand(*shape, -1)
        team = torch.zeros(shape)
        log_probability, entropy = torch.zeros(shape[:2]), torch.zeros(shape[:2])
        prepared = self.prepare(w, agents)
        allocations = []
        for agent in range(r.agents):
            own = r.own[:, agent, None]
            logits = self.logits(w, g, agents[:, agent], counts, team)
            logits = logits.masked_fill(~r.open[:, None], NEVER)
            log = logits.log_softmax(-1)
            task = (log.detach() + noise[:, :, agent]).argmax(-1)
            chosen = log.gather(-1, task[..., None])[..., 0]
            log_probability = log_probability + chosen * own
            entropy = entropy - (log * log.exp()).sum(-1) * own
            joins = one_hot(task, r.tasks) * own[..., None]
            team = team + 0.2 * joins
            g = self.update(w, g, (agents[:, agent], prepared, agent), (task, joins))
            allocations.append(task.masked_fill(~own, -1))
        return torch.stack(allocations, -1), log_probability, entropy

    def prepare(self, w, agents):
        return None

    def logits(self, w, g, h, counts, team):
        counts = torch.stack([counts[:, None].expand_as(team), team], -1)
        embedded = g + F.linear(counts, w["count.weight"], w["count.bias"])
        return (embedded * h[:, None, None]).sum(-1) * h.shape[-1] ** -0.5

    def update(self, w, g, agent, choice):
        """Every subtask's update, masked."""
        both = torch.cat([g, agent[0][:, None, None].expand_as(g)], -1)
        update = F.linear(F.relu(both), w["update.weight"], w["update.bias"])
        return g + update * choice[1][..., None]


class LeanPolicy(Policy):
    """The update of the chosen subtask only, and its agent's half once for all proposals."""

    def prepare(self, w, agents):
        return F.linear(F.relu(agents), w["update.weight"][:, agents.shape[-1] :], w["update.bias"])

    def logits(self, w, g, h, counts, team):
        by_count = h @ w["count.weight"]
        plain = (g.flatten(1, 2) @ h[..., None]).view(team.shape)
        constant = counts * by_count[:, :1] + (h @ w["count.bias"])[:, None]
        return (plain + constant[:, None] + team * by_count[:, 1:, None]) * h.shape[-1] ** -0.5

    def update(self, w, g, agent, choice):
        (h, prepared, number), (task, joins) = agent, choice
        if number + 1 == self.rows.agents:
            return g
        width = h.shape[-1]
        place = task[..., None, None].expand(-1, -1, 1, width)
        update = F.linear(F.relu(g.gather(2, place)[:, :, 0]), w["update.weight"][:, :width])
        update = (update + prepared[:, None, number]) * self.rows.own[:, number, None, None]
        return g.scatter_add(2, place, update[:, :, None])


class Allocation:
    """Policy and critic; a step on decisions."""

    def __init__(self, tensors, settings, rows, critic, policy):
        self.critic, self.target = take(tensors, "critic."), take(tensors, "target_critic.")
        self.policy = take(tensors, "policy.")
        self.popart = PopArt(settings["critic_mean"], settings["critic_variance"])
        self.bootstrap = PopArt(settings["target_critic_mean"], settings["target_critic_variance"])
        self.rows, self.values, self.proposals = rows, critic(rows), policy(rows)
        self.settings = settings
        self.optimisers = [optimiser(self.critic, settings), optimiser(self.policy, settings)]

    def noise(self):
        r = self.rows
        return -torch.empty(len(r.reward), r.proposals, r.agents, r.tasks).exponential_().log()

    def loss(self, noise=None):
        r = self.rows
        noise = self.noise() if noise is None else noise
        proposed, log_probability, entropy = self.proposals.propose(self.policy, noise)
        with torch.no_grad():
            best = self.values.best(self.critic, proposed).argmax(1, keepdim=True)
            allocation = proposed.gather(1, best[..., None].expand(-1, 1, r.agents))
            worth = self.values.value(self.target, allocation, "target")[:, 0]
            worth = worth * self.target["head.weight"] + self.target["head.bias"]
            worth = self.bootstrap.real(worth)
            wanted = r.reward[:-1] + self.settings["discount"] * r.goes_on[:-1] * worth[1:]
        value = self.values.value(self.critic, r.stored[:, None], "stored")[:-1, 0]
        weight, bias = self.critic["head.weight"], self.critic["head.bias"]
        wanted = self.popart.update(wanted, r.mask[:-1], weight, bias)
        error = (value * weight + bias - wanted) * r.weight[:-1]
        surprise = -(log_probability.gather(1, best)[:, 0] * r.weight).sum() / r.weight.sum()
        return {
            "critic": (error**2).sum() / r.weight[:-1].sum(),
            "policy": surprise - self.settings["entropy"] * entropy.mean(),
        }

    def step(self):
        descend(self.loss(), [self.critic, self.policy], self.optimisers, self.settings["clip"])


def take(tensors, of):
    """Weights of a network that can learn."""
    return {k[len(of) :]: v.clone().requires_grad_() for k, v in tensors.items() if k.startswith(of)}


def optimiser(network, settings):
    rate = settings["learning_rate"]
    return torch.optim.RMSprop(network.values(), lr=rate, alpha=0.99, eps=1e-5, foreach=True)


def descend(losses, networks, optimisers, clip):
    """One step of every network down its own loss."""
    for network in networks:
        for weight in network.values():
            weight.grad = None
    sum(losses.values()).backward()
    for network, optimiser in zip(networks, optimisers):
        torch.nn.utils.clip_grad_norm_(network.values(), clip, foreach=True)
        optimiser.step()


def compare(losses, networks, tensors):
    """Loss, gradient norm, and the relative distance of the gradient from the given one, of each loss."""
    sum(losses.values()).backward()
    found = {}
    for name, network in networks.items():
        got = torch.cat([weight.grad.flatten() for weight in network.values()])
        want = torch.cat([tensors[f"gradient.{name}.{part}"].flatten() for part in network])
        found[name] = {
            "loss": losses[name].item(),
            "gradient_norm": got.norm().item(),
            "gradient_error": ((got - want).norm() / want.norm()).item(),
        }
    return found


FORMULATIONS = {"padded": (PaddedLow, Critic, Policy), "lean": (LeanLow, LeanCritic, LeanPolicy)}


def main():
    torch.set_num_threads(1)
    torch.manual_seed(0)
    tensors, settings = read(sys.argv[1])
    batch = Batch(tensors, settings)
    rows = Decisions(tensors, settings, batch)
    build = lambda low, critic, policy: {
        "low_level": LowLevel(tensors, settings, batch, low),
        "allocation": Allocation(tensors, settings, rows, critic, policy),
    }
    ready = {"torch": torch.__version__}
    for name, forms in FORMULATIONS.items():
        levels = build(*forms)
        low, allocation = levels["low_level"], levels["allocation"]
        found = compare(low.loss(), {"online": low.online}, tensors)
        networks = {"critic": allocation.critic, "policy": allocation.policy}
        found.update(compare(allocation.loss(tensors["noise"]), networks, tensors))
        ready[name] = found
    print(json.dumps(ready), flush=True)
    formulations = {name: build(*forms) for name, forms in FORMULATIONS.items()}
    for line in sys.stdin:
        name, level = line.split()
        start = time.process_time()
        formulations[name][level].step()
        print(json.dumps({"cpu_s": time.process_time() - start}), flush=True)


if __name__ == "__main__":
    main()
