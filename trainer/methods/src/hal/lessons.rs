//! What controller and meta-controller learn from in an update.

use sortie_envs::random::chance;
use sortie_envs::{Environment, Random};
use sortie_learn::run::UpdateReport;

use super::Config;
use crate::options::{
    Course, Lesson, Lessons, NONE, Next, OptionPlace, QNetwork, Replay, course, returns,
};
use crate::pictures::Shown;

/// Draws of an option before an update is given up: nothing is kept yet.
const TRIES: usize = 10_000;

/// What updates are made of.
pub(super) struct Update<'a> {
    pub(super) config: &'a Config,
    pub(super) replay: &'a mut Replay,
    pub(super) shown: &'a Shown,
    pub(super) environment: &'a dyn Environment,
    /// How far losses make up for priorities.
    pub(super) exponent: f32,
    pub(super) random: &'a mut Random,
}

impl Update<'_> {
    /// Makes an update of the controller: how actions lead to each milestone (equation 6.1, double Q-learning).
    pub(super) fn controller(&mut self, q: &mut QNetwork, learning_rate: f32) -> UpdateReport {
        let mut lessons = Vec::new();
        while lessons.len() < self.config.replay.batch {
            lessons.extend(self.draw_step());
        }
        let report = q.update(self.lessons(&lessons), learning_rate);
        let drawn = lessons.iter().map(|lesson| lesson.state);
        self.replay.correct_steps(drawn.zip(q.errors().iter().copied()));
        report
    }

    /// Makes an update of the meta-controller: how goals lead to the task. None where too little is kept.
    pub(super) fn meta(&mut self, q: &mut QNetwork, learning_rate: f32) -> Option<UpdateReport> {
        let (batch, milestones) = (self.config.meta.batch, q.network.heads.actions);
        let draws = (0..TRIES).filter_map(|_| self.draw_option(milestones));
        let (drawn, lessons): (Vec<_>, Vec<_>) = draws.take(batch).unzip();
        if lessons.len() < batch {
            return None;
        }
        let report = q.update(self.lessons(&lessons), learning_rate);
        self.replay.correct_options(drawn.into_iter().zip(q.errors().iter().copied()));
        Some(report)
    }

    pub(super) fn lessons<'a>(&'a self, lessons: &'a [Lesson]) -> Lessons<'a> {
        let (exponent, bounded) = (self.exponent, self.config.returns.bounded);
        Lessons { lessons, replay: self.replay, shown: self.shown, exponent, bounded }
    }

    /// A step to learn from; none where it is none to begin with.
    pub(super) fn draw_step(&mut self) -> Option<Lesson> {
        let config = &self.config.returns;
        let (state, priority) = self.replay.draw(self.config.replay.reached, self.random);
        let note = self.replay.steps.note(state);
        let earned = |goal| returns(self.replay, state, config.rules(), config.paid(goal));
        let (own, next) = earned(note.goal)?;
        let other = if config.relabel { note.option_reached } else { NONE };
        let other = if other == note.goal { NONE } else { other };
        let also = if other == NONE { 0.0 } else { earned(other)?.0 };
        let goals = [(note.goal, own), (other, also)];
        let is_mirrored = config.mirror && chance(self.random, 0.5);
        let action = self.replay.steps.actions(state)[0];
        let action = self.environment.turned_action(is_mirrored.into(), action).into();
        Some(Lesson { state, is_mirrored, action, goals, next, priority })
    }

    /// An option to learn from; none where it is none to begin with.
    pub(super) fn draw_option(&mut self, milestones: usize) -> Option<(OptionPlace, Lesson)> {
        let Config { returns, meta, .. } = self.config;
        let (option, priority) = self.replay.draw_option(meta.solved, self.random)?;
        let Course { start: state, goal, reward, next } =
            course(self.replay, option, returns.course_rules(meta, milestones))?;
        let is_mirrored = returns.mirror && chance(self.random, 0.5);
        let everything = |next: Next| Next { mask: u32::MAX, ..next };
        let next = if meta.masked { next } else { next.map(everything) };
        let (action, goals) = (goal.into(), [(0, reward), (NONE, 0.0)]);
        Some((option, Lesson { state, is_mirrored, action, goals, next, priority }))
    }
}
