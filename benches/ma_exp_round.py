"""A round of MA-Exp's preset `paper` in PyTorch: the peer of `sortie bench train --preset paper-ma-exp`.

One thread, two formulations. `published` is structured as the public code is: a network at a time for each agent
and head. `lean` stacks the networks of all agents and heads, and takes the layers that see the state in one product.

Called as `ma_exp_round.py FILE`; what it reads and says is as `rounds.py` has it.
"""

import torch
import torch.nn.functional as F

from rounds import Round, chosen, linear, main, one_hot


class Published(Round):
    """A network at a time."""

    def __init__(self, tensors, settings):
        self.agents, self.heads, self.choices = (int(settings[key]) for key in ("agents", "heads", "choices"))
        self.pairs = [(agent, head) for agent in range(self.agents) for head in range(self.heads)]
        self.states, self.next_states = tensors["states"], tensors["next_states"]
        self.rewards, self.goes_on = tensors["rewards"], tensors["goes_on"]
        all_of = lambda kind: [tensors[f"{kind}.{number}"] for number in range(len(self.pairs))]
        self.own, self.given = self.unite(all_of("own")), [self.unite(all_of(kind)) for kind in ("drawn_next", "drawn")]
        of_agents = lambda kind: [tensors[f"{kind}.{agent}"] for agent in range(self.agents)]
        self.observations, self.next = of_agents("observations"), of_agents("next")
        self.taken = self.unite([of_agents("actions")[agent] for agent, _ in self.pairs])
        super().__init__(tensors, settings)

    def unite(self, parts):
        """What is computed at once of parts by agents and heads."""
        return parts

    def join(self, of):
        """Weights that can learn; a layer that is given in parts is one."""
        given = super().join(of)
        joined = {}
        for name, weight in given.items():
            start = name.rsplit(".", 2)[0]
            if name.endswith(".state.weight"):
                both = [given[start + ".others.weight"], weight]
                joined[start + ".0.weight"] = torch.cat(both, 1).detach().requires_grad_()
            elif name.endswith(".state.bias"):
                joined[start + ".0.bias"] = weight
            elif ".last." in name:
                joined[name.replace(".last.", ".1.")] = weight
            elif not name.endswith(".others.weight"):
                joined[name] = weight
        return joined

    def shares(self):
        return 1.0 / (2 * len(self.pairs)), 1.0 / self.heads

    def scores(self, network, observations):
        found = []
        for agent, seen in enumerate(observations):
            base = F.relu(linear(seen, self.layer(network, f"policy.{agent}.0")))
            for head in range(self.heads):
                hidden = F.relu(linear(base, self.layer(network, f"policy.{agent}.{2 * head + 1}")))
                found.append(linear(hidden, self.layer(network, f"policy.{agent}.{2 * head + 2}")))
        return found

    def values(self, network, states, taken):
        """By agents and heads the values of own actions, of both rewards."""
        state = F.relu(linear(states, self.layer(network, "encoder")))
        found = []
        for agent, head in self.pairs:
            others = [taken[other * self.heads + head] for other in range(self.agents) if other != agent]
            seen = torch.cat([one_hot(actions, self.choices) for actions in others] + [state], -1)
            both = []
            for kind in ("team", "own"):
                name = f"{kind}.{head}.{agent}"
                hidden = F.relu(linear(seen, self.layer(network, f"{name}.0")))
                both.append(linear(hidden, self.layer(network, f"{name}.1")))
            found.append(both)
        return found

    def base_names(self):
        return [name for name in self.policies if name.split(".")[2] == "0"]

    def clip_policies(self):
        for agent in range(self.agents):
            weights = [w for name, w in self.policies.items() if name.startswith(f"policy.{agent}.")]
            torch.nn.utils.clip_grad_norm_(weights, self.settings["policy_clip"], foreach=True)

    def targets(self, given):
        settings = self.settings
        with torch.no_grad():
            scores = self.scores(self.target_policies, self.next)
            actions = self.draw(scores, given)
            found = []
            values = self.values(self.target_critic, self.next_states, actions)
            for score, taken, (team, own), paid in zip(scores, actions, values, self.own):
                surprise = chosen(score.log_softmax(-1), taken) * settings["entropy"]
                worth = self.goes_on * settings["discount"] * chosen(team, taken)
                own_worth = self.goes_on * settings["own_discount"] * chosen(own, taken)
                found.append((self.rewards + worth - surprise, paid + own_worth - surprise))
            return found

    def learn(self, given):
        """One round; returns the loss of the critic."""
        for optimiser in self.optimisers:
            optimiser.zero_grad(set_to_none=True)
        targets = self.targets(given[0])
        loss = 0.0
        values = self.values(self.critic, self.states, self.taken)
        for (team, own), wanted, taken in zip(values, targets, self.taken):
            error = (chosen(team, taken) - wanted[0]) ** 2
            own_error = F.smooth_l1_loss(chosen(own, taken), wanted[1], reduction="none")
            loss = loss + (error + own_error).mean(-1).sum()
        loss.backward()
        critic_share, self.base_share = self.shares()
        for name in ("encoder.weight", "encoder.bias"):
            self.critic[name].grad *= critic_share
        weights = self.critic.values()
        self.norm = torch.nn.utils.clip_grad_norm_(weights, self.settings["critic_clip"], foreach=True)
        self.optimisers[0].step()
        self.improve(given[1])
        self.follow()
        return loss

    def improve(self, given):
        scores = self.scores(self.policies, self.observations)
        with torch.no_grad():
            actions = self.draw(scores, given)
            values = self.values(self.critic, self.states, actions)
        loss, entropy = 0.0, self.settings["entropy"]
        for score, taken, (team, own) in zip(scores, actions, values):
            logs = score.log_softmax(-1)
            surprise = chosen(logs, taken)
            with torch.no_grad():
                worth = team + self.settings["own_weight"] * own
                mean = (logs.exp() * worth).sum(-1)
                factor = entropy * surprise - (chosen(worth, taken) - mean)
            loss = loss + (surprise * factor).mean(-1).sum()
            loss = loss + self.settings["score_penalty"] * (score**2).mean((-1, -2)).sum()
        loss.backward()
        for name in self.base_names():
            self.policies[name].grad *= self.base_share
        self.clip_policies()
        self.optimisers[1].step()


class Lean(Published):
    """All agents and heads at once."""

    def optimiser(self):
        return {"fused": True}

    def unite(self, parts):
        return torch.stack(parts)[None]

    def join(self, of):
        """Weights of layers that do the same as one tensor each, those of the team's values before those of own ones."""
        given = super().join(of)
        taken = lambda name: given[name].detach()
        if any(name.startswith("policy.") for name in given):
            agents = range(self.agents)
            heads = lambda layer, end: torch.stack(
                [taken(f"policy.{agent}.{2 * head + layer}.{end}") for agent, head in self.pairs]
            )
            joined = {}
            for end in ("weight", "bias"):
                joined[f"base.{end}"] = torch.stack([taken(f"policy.{agent}.0.{end}") for agent in agents])
                joined[f"hidden.{end}"] = heads(1, end).unflatten(0, (self.agents, -1)).flatten(1, 2)
                joined[f"last.{end}"] = heads(2, end)
        else:
            name = lambda kind, layer, end, agent, head: f"{kind}.{head}.{agent}.{layer}.{end}"
            every = lambda layer, end: torch.stack(
                [taken(name(kind, layer, end, *pair)) for kind in ("team", "own") for pair in self.pairs]
            )
            first = every(0, "weight")
            others = (self.agents - 1) * self.choices
            joined = {
                "encoder.weight": taken("encoder.weight"),
                "encoder.bias": taken("encoder.bias"),
                "others.weight": first[..., :others],
                "state.weight": first[..., others:],
                "first.bias": every(0, "bias"),
                "last.weight": every(1, "weight"),
                "last.bias": every(1, "bias"),
            }
        return {name: weight.clone().requires_grad_() for name, weight in joined.items()}

    def scores(self, network, observations):
        seen = torch.stack(list(observations))
        base = F.relu(linear(seen, self.layer(network, "base")))
        hidden = F.relu(linear(base, self.layer(network, "hidden")))
        hidden = hidden.unflatten(-1, (self.heads, -1)).transpose(1, 2).flatten(0, 1)
        return linear(hidden, self.layer(network, "last"))[None]

    def values(self, network, states, taken):
        state = F.relu(linear(states, self.layer(network, "encoder")))
        does = one_hot(taken[0], self.choices).unflatten(0, (self.agents, -1))
        rest = lambda agent: [does[other] for other in range(self.agents) if other != agent]
        others = torch.cat([torch.cat(rest(agent), -1) for agent in range(self.agents)]).repeat(2, 1, 1)
        turned = lambda name: network[name].transpose(1, 2)
        bias = network["first.bias"][:, None]
        hidden = torch.baddbmm(bias, others, turned("others.weight"))
        count, width = bias.shape[0], bias.shape[-1]
        seen = (state @ network["state.weight"].flatten(0, 1).t()).view(-1, count, width).transpose(0, 1)
        both = linear(F.relu(hidden + seen), self.layer(network, "last"))
        return [both.unflatten(0, (2, -1)).unbind(0)]

    def base_names(self):
        return ["base.weight", "base.bias"]

    def clip_policies(self):
        with torch.no_grad():
            grads = [w.grad.unflatten(0, (self.agents, -1)) for w in self.policies.values()]
            norms = sum((grad**2).flatten(1).sum(1) for grad in grads).sqrt()
            factor = (self.settings["policy_clip"] / (norms + 1e-6)).clamp(max=1.0)
            for grad in grads:
                grad *= factor.view(-1, *[1] * (grad.dim() - 1))


if __name__ == "__main__":
    main({"published": Published, "lean": Lean})
