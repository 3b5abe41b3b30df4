"""A round of MAAC's preset `paper` in PyTorch: the peer of `sortie bench train --preset paper-maac`.

One thread, two formulations. `published` is structured as the public code is: a network at a time for each
agent, an attention head at a time. `lean` stacks the networks of agents that observe and do as much, takes all
heads in one product, and normalises what several networks are shown once.

Called as `maac_round.py FILE`; what it reads and says is as `rounds.py` has it.
"""

import torch
import torch.nn.functional as F

from rounds import Round, chosen, linear, main, one_hot

LAYERS = {"action_encoder", "state_encoder", "hidden", "head"}


def leaky(x, layer):
    return F.leaky_relu(linear(x, layer), 0.01)


class Published(Round):
    """A network at a time."""

    def __init__(self, tensors, settings):
        self.heads = int(settings["heads"])
        self.agents = int(settings["agents"])
        self.tensors = tensors
        self.units = self.divide()
        self.observations, self.next = self.rows("observations"), self.rows("next")
        self.actions, self.rewards = self.rows("actions"), self.rows("rewards")
        self.discounts = self.rows("discounts")
        self.given = [self.rows("drawn_next"), self.rows("drawn")]
        self.counts = [self.actions_of(unit) for unit in self.units]
        self.running = {}
        super().__init__(tensors, settings)

    def divide(self):
        """Agents by the networks that are computed at once."""
        return [[agent] for agent in range(self.agents)]

    def together(self, parts):
        """One tensor for the networks of a unit."""
        return parts[0]

    def actions_of(self, unit):
        return len(self.tensors[f"critic.head.{unit[0]}.bias"])

    def join(self, of):
        """Weights that can learn, those of agents by units."""
        joined = {}
        for name in self.named(of):
            kind, rest = name.split(".", 1)
            if kind in LAYERS or kind == "policy":
                agent, end = rest.split(".", 1)
                unit = next((at for at, unit in enumerate(self.units) if unit[0] == int(agent)), None)
                if unit is None:
                    continue
                parts = [self.tensors[f"{of}{kind}.{member}.{end}"] for member in self.units[unit]]
                joined[f"{kind}.{unit}.{end}"] = self.together(parts).clone().requires_grad_()
            else:
                joined[name] = self.tensors[of + name].clone().requires_grad_()
        return joined

    def rows(self, kind):
        return [self.together([self.tensors[f"{kind}.{agent}"] for agent in unit]) for unit in self.units]

    def shown(self, observations):
        """What all networks are shown of a batch, as far as it is computed once."""
        return observations

    def normalise(self, key, x):
        """Normalisation of one network, with running statistics of its own."""
        if key not in self.running:
            self.running[key] = torch.zeros(x.shape[-1]), torch.ones(x.shape[-1])
        return F.batch_norm(x, *self.running[key], training=True, momentum=0.1, eps=1e-5)

    def scores(self, network, observations):
        found = []
        for unit, seen in enumerate(observations):
            x = self.normalise(("policy", id(network), unit), seen)
            x = leaky(x, self.layer(network, f"policy.{unit}.0"))
            x = leaky(x, self.layer(network, f"policy.{unit}.1"))
            found.append(linear(x, self.layer(network, f"policy.{unit}.2")))
        return found

    def encoded(self, network, observations, actions):
        """Embeddings of observations with actions, and of observations alone, by units."""
        encoded, states = [], []
        for unit, (seen, taken) in enumerate(zip(observations, actions)):
            both = torch.cat([seen, one_hot(taken, self.counts[unit])], -1)
            both = self.normalise(("both", id(network), unit), both)
            encoded.append(leaky(both, self.layer(network, f"action_encoder.{unit}")))
            seen = self.normalise(("state", id(network), unit), seen)
            states.append(leaky(seen, self.layer(network, f"state_encoder.{unit}")))
        return encoded, states

    def values(self, network, observations, actions):
        """By units the values of own actions, and the squared scores of attention."""
        encoded, states = self.encoded(network, observations, actions)
        others, squares = self.look(network, encoded, states)
        found = []
        for unit, (state, seen) in enumerate(zip(states, others)):
            hidden = leaky(torch.cat([state, seen], -1), self.layer(network, f"hidden.{unit}"))
            found.append(linear(hidden, self.layer(network, f"head.{unit}")))
        return found, squares

    def look(self, network, encoded, states):
        split = lambda name: network[name].chunk(self.heads)
        heads = zip(split("key.weight"), split("query.weight"), split("value.weight"), split("value.bias"))
        found, squares = [[] for _ in states], 0.0
        for key, query, value, bias in heads:
            keys = [x @ key.t() for x in encoded]
            values = [leaky(x, (value, bias)) for x in encoded]
            queries = [x @ query.t() for x in states]
            for agent, own in enumerate(queries):
                rest = [other for other in range(self.agents) if other != agent]
                theirs = torch.stack([keys[other] for other in rest]).permute(1, 2, 0)
                scores = own[:, None] @ theirs
                weights = (scores * own.shape[-1] ** -0.5).softmax(-1)
                worth = torch.stack([values[other] for other in rest]).permute(1, 2, 0)
                found[agent].append((worth * weights).sum(-1))
                squares = squares + (scores**2).mean()
        return [torch.cat(parts, -1) for parts in found], squares

    def clip_policies(self):
        for unit in range(len(self.units)):
            weights = [w for name, w in self.policies.items() if name.startswith(f"policy.{unit}.")]
            torch.nn.utils.clip_grad_norm_(weights, self.settings["policy_clip"], foreach=True)

    def targets(self, given):
        with torch.no_grad():
            shown = self.shown(self.next)
            scores = self.scores(self.target_policies, shown)
            actions = self.draw(scores, given)
            values, _ = self.values(self.target_critic, shown, actions)
            found = []
            for unit, taken in enumerate(actions):
                surprise = chosen(scores[unit].log_softmax(-1), taken) * self.settings["entropy"]
                worth = self.discounts[unit] * chosen(values[unit], taken)
                found.append(self.rewards[unit] + worth - surprise)
            return found

    def learn(self, given):
        """One round; returns the loss of the critic."""
        for optimiser in self.optimisers:
            optimiser.zero_grad(set_to_none=True)
        targets = self.targets(given[0])
        shown = self.shown(self.observations)
        values, squares = self.values(self.critic, shown, self.actions)
        loss = self.settings["attention_penalty"] * squares
        for unit, wanted in enumerate(targets):
            error = chosen(values[unit], self.actions[unit]) - wanted
            loss = loss + (error**2).mean(-1).sum()
        loss.backward()
        for name, weight in self.critic.items():
            if name.split(".")[0] in {"key", "query", "value", "action_encoder"}:
                weight.grad *= 1.0 / self.agents
        clip = self.settings["critic_clip"] * self.agents
        self.norm = torch.nn.utils.clip_grad_norm_(self.critic.values(), clip, foreach=True)
        self.optimisers[0].step()
        self.improve(shown, given[1])
        self.follow()
        return loss

    def improve(self, shown, given):
        scores = self.scores(self.policies, shown)
        with torch.no_grad():
            actions = self.draw(scores, given)
            values, _ = self.values(self.critic, shown, actions)
        loss, entropy = 0.0, self.settings["entropy"]
        for unit, taken in enumerate(actions):
            logs = scores[unit].log_softmax(-1)
            surprise = chosen(logs, taken)
            with torch.no_grad():
                mean = (logs.exp() * values[unit]).sum(-1)
                factor = entropy * surprise - (chosen(values[unit], taken) - mean)
            loss = loss + (surprise * factor).mean(-1).sum()
            loss = loss + self.settings["score_penalty"] * (scores[unit] ** 2).mean((-1, -2)).sum()
        loss.backward()
        self.clip_policies()
        self.optimisers[1].step()


class Lean(Published):
    """Agents that observe and do as much at once."""

    def optimiser(self):
        return {"fused": True}

    def divide(self):
        units = {}
        for agent in range(self.agents):
            size = self.tensors[f"observations.{agent}"].shape[1], self.actions_of([agent])
            units.setdefault(size, []).append(agent)
        return list(units.values())

    def together(self, parts):
        return torch.stack(parts)

    def shown(self, observations):
        return [normalised(seen) for seen in observations]

    def normalise(self, key, x):
        return x

    def encoded(self, network, observations, actions):
        taken = [normalised(one_hot(taken, count)) for taken, count in zip(actions, self.counts)]
        encoded, states = [], []
        for unit, seen in enumerate(observations):
            both = torch.cat([seen, taken[unit]], -1)
            encoded.append(leaky(both, self.layer(network, f"action_encoder.{unit}")))
            states.append(leaky(seen, self.layer(network, f"state_encoder.{unit}")))
        return encoded, states

    def look(self, network, encoded, states):
        encoded, states = torch.cat(encoded), torch.cat(states)
        split = lambda x: x.unflatten(-1, (self.heads, -1)).permute(1, 2, 0, 3)
        keys = split(encoded @ network["key.weight"].t())
        values = encoded @ network["value.weight"].t() + network["value.bias"]
        values = split(F.leaky_relu(values, 0.01))
        queries = split(states @ network["query.weight"].t())
        scores = queries @ keys.transpose(-1, -2)
        own = torch.eye(self.agents, dtype=torch.bool)
        weights = (scores * queries.shape[-1] ** -0.5).masked_fill(own, -1e30).softmax(-1)
        seen = (weights @ values).permute(2, 0, 1, 3).flatten(-2)
        squares = (scores.masked_fill(own, 0.0) ** 2).sum() / (len(states[0]) * (self.agents - 1))
        return seen.split([len(unit) for unit in self.units]), squares

    def clip_policies(self):
        with torch.no_grad():
            for unit in range(len(self.units)):
                grads = [w.grad for name, w in self.policies.items() if name.startswith(f"policy.{unit}.")]
                norms = sum((grad**2).flatten(1).sum(1) for grad in grads).sqrt()
                factor = (self.settings["policy_clip"] / (norms + 1e-6)).clamp(max=1.0)
                for grad in grads:
                    grad *= factor.view(-1, *[1] * (grad.dim() - 1))


def normalised(x):
    """Columns over the batch, mean 0 and variance 1."""
    variance, mean = torch.var_mean(x, -2, unbiased=False, keepdim=True)
    return (x - mean) * (variance + 1e-5).rsqrt()


if __name__ == "__main__":
    main({"published": Published, "lean": Lean})
