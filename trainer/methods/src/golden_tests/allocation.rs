//! The allocation networks and one step of their learner against the reference's.

use crate::alma::windows::allocation::{
    AllocationCritic, AllocationLearning, AllocationLevel, AllocationNetworks, AllocationPolicy,
    AllocationShape, Decider, Noise, States, StepDraws, TaskColumns,
};
use crate::alma::windows::config::AllocationConfig;
use crate::alma::windows::{Config, NO_TASK, PopArt, WindowShape, Windows};
use sortie_learn::networks::Targets;
use sortie_learn::random::{Purpose, generator};

use super::assert_close;
use super::coach::columns as rows_of;
use super::files::{Case, Tensor, json_cases, safetensors_case};
use super::windows::{task_of, windows};

const HEADS: usize = 4;

/// Recorded tensors under a prefix in the order of a network's parameters: those of embeddings turned.
struct Recorded<'a> {
    case: &'a Case,
    prefix: &'a str,
    values: Vec<f32>,
}

impl<'a> Recorded<'a> {
    fn new(case: &'a Case, prefix: &'a str) -> Self {
        Self { case, prefix, values: Vec::new() }
    }

    fn name(&self, name: &str) -> String {
        format!("{}{name}", self.prefix)
    }

    fn add(&mut self, names: &[&str]) {
        for name in names {
            self.values.extend(self.case.get(&self.name(name)).f32s());
        }
    }

    fn add_turned(&mut self, names: &[&str]) {
        let names: Vec<String> = names.iter().map(|name| self.name(name)).collect();
        self.values.extend(rows_of(self.case, &names));
    }

    /// Sizes by the embeddings of entities and of tasks.
    fn shape(&self, entities: &str, tasks: &str) -> AllocationShape {
        let sizes = |name: &str| &self.case.get(&self.name(name)).shape;
        let (of_entities, columns) = (sizes(entities), sizes(tasks)[1]);
        let [width, features] = of_entities[..] else { panic!("sizes") };
        AllocationShape { features, columns, width, heads: HEADS }
    }
}

const ATTENTION: [&str; 3] =
    ["attn.in_trans.weight", "attn.out_trans.weight", "attn.out_trans.bias"];

/// The critic whose tensors stand under a prefix; without a PopArt head it is the identity.
fn critic(case: &Case, prefix: &str) -> AllocationCritic {
    let mut recorded = Recorded::new(case, prefix);
    let shape = recorded.shape("in_fc_ent.weight", "in_fc_alloc.fc.weight");
    let counts = "count_embed.count_embed.weight";
    recorded.add_turned(&["in_fc_ent.weight", "in_fc_alloc.fc.weight", counts]);
    recorded.add(&["count_embed.count_embed.bias", "in_fc_ent.bias"]);
    recorded.add(&ATTENTION);
    recorded.add(&["out_fc.weight", "out_fc.bias"]);
    for (name, nothing) in [("popart_weight", 1.0), ("popart_bias", 0.0)] {
        let tensor = case.tensors.get(&recorded.name(name));
        recorded.values.push(tensor.map_or(nothing, |tensor| tensor.f32s()[0]));
    }
    let mut critic = AllocationCritic::initialise(shape, &mut generator(1, Purpose::Weights, 0));
    assert_eq!(critic.parameters.values.len(), recorded.values.len(), "tensors that fit");
    critic.parameters.values = recorded.values;
    critic
}

/// The policy whose tensors stand under a prefix.
fn policy(case: &Case, prefix: &str) -> AllocationPolicy {
    let mut recorded = Recorded::new(case, prefix);
    let shape = recorded.shape("fc1.weight", "task_embed.fc.weight");
    recorded.add_turned(&["fc1.weight", "task_embed.fc.weight"]);
    recorded.add(&["fc1.bias"]);
    recorded.add(&ATTENTION);
    recorded.add_turned(&["count_embed.weight"]);
    recorded.add(&["count_embed.bias"]);
    // Of every row of the update, the task's half stands before the agent's.
    let update = case.get(&recorded.name("embed_update.weight")).f32s();
    for half in [0, 1] {
        let rows = update.chunks(shape.width).skip(half).step_by(2);
        recorded.values.extend(rows.flatten());
    }
    recorded.add(&["embed_update.bias"]);
    let mut policy = AllocationPolicy::initialise(shape, &mut generator(1, Purpose::Weights, 0));
    assert_eq!(policy.parameters.values.len(), recorded.values.len(), "tensors that fit");
    policy.parameters.values = recorded.values;
    policy
}

/// The columns of tasks, where the reference says which task each column stands for.
fn columns(order: &[f64]) -> Vec<u8> {
    let column = |task: usize| order.iter().position(|t| *t == task as f64);
    (0..order.len()).map(|task| column(task).expect("an order of all tasks") as u8).collect()
}

fn columns_of(case: &Case, tasks: usize) -> TaskColumns {
    match case.tensors.get("in/task_perm") {
        Some(order) => TaskColumns { policy: columns(&order.data), critic: columns(&order.data) },
        None => TaskColumns::in_order(tasks),
    }
}

/// The subtask of every row of memberships, where 1 is a member.
fn tasks_of(member: &Tensor, yes: f64) -> Vec<u8> {
    let tasks = *member.shape.last().expect("tasks");
    let member: Vec<bool> = member.data.iter().map(|v| *v == yes).collect();
    member.chunks(tasks).map(task_of).collect()
}

/// The states of a recorded case; where it has no last allocation, nobody had one.
fn states(case: &Case, agents: usize) -> States {
    let entities = case.get("in/entities");
    let [count, slots, width] = entities.shape[..] else { panic!("sizes") };
    let entity_task = tasks_of(case.get("in/entity2task_mask"), 0.0);
    let tasks = case.get("in/entity2task_mask").shape[2];
    let present: Vec<bool> = case.get("in/entity_mask").data.iter().map(|v| *v == 0.0).collect();
    let open = match case.tensors.get("in/task_mask") {
        Some(mask) => mask.data.iter().map(|v| *v == 0.0).collect(),
        None => vec![true; count * tasks],
    };
    let last = match case.tensors.get("in/last_alloc") {
        Some(last) => tasks_of(last, 1.0),
        None => vec![NO_TASK; count * agents],
    };
    let mut windows = Windows::new(WindowShape {
        windows: count,
        steps: 1,
        agents,
        entities: slots,
        tasks,
        actions: 0,
        features: width,
        targets: Targets::NONE,
    });
    windows.features.clear();
    entities.f32s().chunks(width).for_each(|row| windows.features.push_dense(row));
    (windows.present, windows.entity_task, windows.open) = (present, entity_task, open);
    let mut states = States::new(agents, slots, tasks);
    for (state, last) in last.chunks(agents).enumerate() {
        states.push(&windows, state, last);
    }
    states
}

#[test]
fn critic_agrees() {
    for case in json_cases("alloc_critic") {
        let critic = critic(&case, "w/");
        let given = case.get("in/override_alloc");
        let states = states(&case, given.shape[2]);
        let columns = columns_of(&case, given.shape[3]);
        let mut decider = Decider::default();
        let stored: Vec<u8> =
            (0..states.len()).flat_map(|s| states.allocation(s).to_vec()).collect();
        let got = decider.value(&critic, &states, &columns, &stored);
        assert_close(&case.name, &got, &case.get("out/q_stored").data);
        let given = tasks_of(given, 1.0);
        let got = decider.value(&critic, &states, &columns, &given);
        assert_close(&case.name, &got, &case.get("out/q_override").data);
    }
}

/// The recorded allocations, in which absent agents are -1.
fn allocations(tensor: &Tensor) -> Vec<u8> {
    let task = |v: &f64| if *v < 0.0 { NO_TASK } else { *v as u8 };
    tensor.data.iter().map(task).collect()
}

#[test]
fn policy_agrees() {
    for case in json_cases("alloc_policy_default") {
        let policy = policy(&case, "w/");
        let gumbel = case.get("in/gumbel");
        let [_, proposals, agents, tasks] = gumbel.shape[..] else { panic!("sizes") };
        let states = states(&case, agents);
        let noise = gumbel.f32s();
        let sampling = (proposals, Noise::Gumbel(&noise));
        let columns = columns_of(&case, tasks);
        let got = Decider::default().propose(&policy, &states, &columns, sampling);
        assert_eq!(got.allocations, allocations(case.get("out/alloc")), "{}", case.name);
        assert_close(&case.name, &got.log_probabilities, &case.get("out/log_pi").data);
        assert_close(&case.name, &got.entropies, &case.get("out/entropy").data);
    }
}

#[test]
fn decisions_at_save_the_city_sizes_agree() {
    let case = safetensors_case("networks", "allocation_decision_default");
    let (critic, policy) = (critic(&case, "w/critic."), policy(&case, "w/policy."));
    let gumbel = case.get("in/gumbel");
    let [_, proposals, agents, tasks] = gumbel.shape[..] else { panic!("sizes") };
    let states = states(&case, agents);
    let noise = gumbel.f32s();
    let sampling = (proposals, Noise::Gumbel(&noise));
    let columns = columns_of(&case, tasks);
    let mut decider = Decider::default();

    let proposed = decider.propose(&policy, &states, &columns, sampling);
    assert_eq!(proposed.allocations, allocations(case.get("out/proposals")));
    assert_close("log f", &proposed.log_probabilities, &case.get("out/log_pi").data);
    let values = decider.value(&critic, &states, &columns, &proposed.allocations);
    assert_close("values", &values, &case.get("out/critic_values").data);

    let networks = AllocationNetworks { policy: &policy, critic: &critic };
    let decided = decider.decide(networks, &states, &columns, sampling);
    assert_eq!(decided.best, allocations(case.get("out/best_alloc")));
    let first = proposed.allocations.chunks(proposals * agents).flat_map(|own| &own[..agents]);
    assert!(decided.first.iter().eq(first));
}

/// The level of the recorded step, and the case.
fn recorded_level() -> (AllocationLevel, Case) {
    let case = safetensors_case("learner", "alloc_aql_0");
    let popart = PopArt { mean: 0.25, variance: 2.25, started: true };
    let with_statistics = |prefix| {
        let mut critic = critic(&case, prefix);
        critic.popart = popart;
        critic
    };
    let policy = policy(&case, "w/policy.");
    let usual = AllocationLearning::of(&Config::default(), windows(&case).shape);
    let config = AllocationConfig { proposals: 4, interval: 3, ..usual.config.clone() };
    assert_eq!((config.rows, config.oldest), (400, 150_000));
    let (shape, as_public_code) = (policy.shape, true);
    let learning = AllocationLearning { shape, config, as_public_code, ..usual };
    let (online, target) = (with_statistics("w/critic."), with_statistics("target_w/critic."));
    let mut level = AllocationLevel::new(learning, 1);
    (level.critic, level.policy, level.target) = (online, policy, target);
    (level, case)
}

fn recorded_draws(noise: &[f32]) -> StepDraws<'_> {
    let order = columns(&[2.0, 0.0, 1.0]);
    StepDraws {
        proposals: TaskColumns { policy: order.clone(), critic: order.clone() },
        stored: order.clone(),
        target: order,
        noise: Noise::Gumbel(noise),
    }
}

#[test]
fn recorded_step_agrees() {
    let (mut level, case) = recorded_level();
    let noise = case.get("in/gumbel").f32s();
    let windows = windows(&case);
    let draws = recorded_draws(&noise);
    let report = level.learn_with(&windows, 1_000_000, &draws, 2).expect("rows to learn from");

    let step = &level.last;
    let number = |flags: &[bool]| flags.iter().map(|f| f32::from(u8::from(*f))).collect::<Vec<_>>();
    let rows = &step.rows;
    assert_close("reward", &rows.reward, &case.get("out/meta/reward").data);
    assert_close("end", &number(&rows.terminated), &case.get("out/meta/terminated").data);
    assert_close("mask", &number(&rows.mask), &case.get("out/meta/mask").data);
    let narrow = |values: &[f64]| values.iter().map(|v| *v as f32).collect::<Vec<_>>();
    assert_close("targets", &narrow(&step.targets), &case.get("out/targets").data);
    assert_close("normalised", &narrow(&step.normalised), &case.get("out/targets_normalised").data);
    assert_eq!(step.best, tasks_of(case.get("out/best_alloc"), 1.0));
    let popart = level.critic.popart;
    assert_close("mean", &[popart.mean as f32], &case.get("out/popart_mean").data);
    assert_close("variance", &[popart.variance as f32], &case.get("out/popart_var").data);
    for (name, got) in [
        ("losses.alloc_q_loss", report.critic_loss),
        ("losses.alloc_amort_loss", report.policy_loss),
        ("losses.alloc_entropy", report.entropy),
        ("train_metrics.alloc_q_grad_norm", f64::from(report.critic_norm)),
        ("train_metrics.alloc_pi_grad_norm", f64::from(report.policy_norm)),
    ] {
        assert_close(name, &[got as f32], &case.get(&format!("out/stat/{name}")).data);
    }

    let want = |prefix| critic(&case, prefix).parameters.values;
    compare(&step.critic_gradient, &want("out/grad/critic."), None);
    let after = &level.critic.parameters.values;
    compare(after, &want("out/after/critic."), Some(&step.critic_gradient));
    let want = |prefix| policy(&case, prefix).parameters.values;
    compare(&step.policy_gradient, &want("out/grad/policy."), None);
    let after = &level.policy.parameters.values;
    compare(after, &want("out/after/policy."), Some(&step.policy_gradient));
}

/// Compares gradients, or parameters after a step where gradients are given: those below 1e-9 say nothing
/// of the sign of the step.
fn compare(got: &[f32], want: &[f32], gradients: Option<&[f32]>) {
    assert_eq!(got.len(), want.len());
    for (place, (got, want)) in got.iter().zip(want).enumerate() {
        let limit = match gradients {
            None => 1e-6 + 1e-3 * want.abs(),
            Some(gradients) if gradients[place].abs() < 1e-9 => continue,
            Some(_) => 1e-5,
        };
        assert!((got - want).abs() <= limit, "{place}: {got} against {want}");
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let (level, case) = recorded_level();
    let noise = case.get("in/gumbel").f32s();
    let windows = windows(&case);
    let step = |threads: usize| {
        let mut level = level.clone();
        let report = level.learn_with(&windows, 1_000_000, &recorded_draws(&noise), threads);
        let AllocationLevel { critic, policy, optimisers, .. } = level;
        (report.expect("rows to learn from"), critic, policy, optimisers)
    };
    let one = step(1);
    assert_eq!(one, step(2));
    assert_eq!(one, step(3));
}
