//! Writes episodes as they are played.

use std::any::Any;
use std::fmt::Write;

use serde_json::{Value, json};

use super::super::simulator::SaveTheCity;
use super::SCHEMA;
use super::events::Events;
use super::frames;
use crate::environment::{Environment, Step};
use crate::recorded::{Labels, Record};

/// Records one episode of one instance.
///
/// Start it right after a reset, tell it every step, and take the text when the episode is done and
/// the instance not yet reset.
pub struct Recorder {
    labels: Labels,
    instance: usize,
    config: Value,
    initial: Value,
    static_masks: Value,
    scenario_set: String,
    frames: Vec<Value>,
    steps: Vec<Value>,
    events: Events,
}

impl Recorder {
    /// Starts with the first state of an episode.
    pub fn new(environment: &SaveTheCity, instance: usize, labels: Labels) -> Self {
        let city = environment.city(instance);
        let mut events = Events::default();
        events.before_step(city);
        Self {
            labels,
            instance,
            config: frames::config(environment),
            initial: frames::initial(city),
            static_masks: frames::static_masks(environment, instance),
            scenario_set: environment.scenario_set().name.clone(),
            frames: vec![frames::frame(environment, instance, true)],
            steps: Vec::new(),
            events,
        }
    }

    /// Adds the step that was just taken.
    pub fn record(&mut self, environment: &SaveTheCity, actions: &[u16], outcome: &Step) {
        let instance = self.instance;
        self.steps.push(frames::step(environment, instance, actions, outcome));
        let features = has_features(self.steps.len(), outcome.done());
        self.frames.push(frames::frame(environment, instance, features));
        self.events.after_step(environment, instance, actions);
        self.events.before_step(environment.city(instance));
    }

    /// The episode as text, a line per state and step.
    pub fn finish(mut self, environment: &SaveTheCity) -> String {
        let mut text = String::from("{\n");
        for (name, value) in [
            ("schema", json!(SCHEMA)),
            ("name", json!(self.labels.name)),
            ("seed", json!(self.labels.seed)),
            ("scenario_set", json!(self.scenario_set)),
            ("policy", json!(self.labels.policy)),
            ("config", self.config),
            ("initial", self.initial),
            ("static_masks", self.static_masks),
            ("length", json!(self.steps.len())),
            ("events", self.events.finish(environment, self.instance)),
        ] {
            line(&mut text, format_args!("\"{name}\":{value},"));
        }
        list(&mut text, "frames", &self.frames, ",");
        list(&mut text, "steps", &self.steps, "");
        text.push_str("}\n");
        text
    }
}

/// Starts to record the episode of an instance.
pub(super) fn start(
    environment: &dyn Environment,
    instance: usize,
    labels: Labels,
) -> Option<Box<dyn Record>> {
    let recorder = Recorder::new(city(environment)?, instance, labels);
    Some(Box::new(recorder))
}

fn city(environment: &dyn Environment) -> Option<&SaveTheCity> {
    let environment: &dyn Any = environment;
    environment.downcast_ref()
}

impl Record for Recorder {
    fn step(&mut self, environment: &dyn Environment, actions: &[u16], step: &Step) {
        if let Some(city) = city(environment) {
            self.record(city, &actions[..city.agent_count(self.instance)], step);
        }
    }

    fn finish(self: Box<Self>, environment: &dyn Environment) -> String {
        city(environment).map_or_else(String::new, |city| Recorder::finish(*self, city))
    }
}

/// Features are written for the first state, every tenth and the last.
pub(super) fn has_features(state: usize, last: bool) -> bool {
    state.is_multiple_of(10) || last
}

fn list(text: &mut String, name: &str, values: &[Value], end: &str) {
    line(text, format_args!("\"{name}\":["));
    for (index, value) in values.iter().enumerate() {
        let comma = if index + 1 < values.len() { "," } else { "" };
        line(text, format_args!("{value}{comma}"));
    }
    line(text, format_args!("]{end}"));
}

fn line(text: &mut String, content: std::fmt::Arguments<'_>) {
    writeln!(text, "{content}").expect("writing to a text in memory cannot fail");
}
