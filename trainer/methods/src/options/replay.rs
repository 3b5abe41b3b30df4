//! What is kept: what every instance did, step by step, and the options that these steps make up.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use sortie_envs::Random;
use sortie_envs::random::{below, chance};
use sortie_learn::trajectory::{Capacity, End, Place, Priorities, Widths};
use sortie_learn::{LearnError, State, Trajectories, Transition};

/// No milestone.
pub(crate) const NONE: u8 = u8::MAX;

/// What is known of a step besides what any trajectory tells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Note {
    pub(crate) goal: u8,
    /// The milestone that the step reached, or none.
    pub(crate) reached: u8,
    /// Whether its episode had not reached it before.
    pub(crate) is_first: bool,
    /// The milestone that the option reached; told to all of its steps when it is over.
    pub(crate) option_reached: u8,
    /// Whether the step changed nothing that is seen.
    pub(crate) changed_nothing: bool,
    /// Whether the option was over behind it.
    pub(crate) ends_option: bool,
}

/// An option that is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Finished {
    pub(crate) start: Place,
    pub(crate) steps: u8,
    pub(crate) goal: u8,
    pub(crate) reached: u8,
    /// The milestones that could be chosen from.
    pub(crate) mask: u32,
    /// How its last step left the episode; where it goes on, the next option follows in the list of the instance.
    pub(crate) end: End,
}

/// An option by its instance and its number there.
pub(crate) type OptionPlace = (u32, u32);

/// Everything that is kept.
#[derive(Clone, Debug)]
pub(crate) struct Replay {
    /// States are the bytes that networks are shown.
    pub(crate) steps: Trajectories<Note>,
    /// Of each instance, with how many were forgotten before.
    options: Vec<(u32, VecDeque<Finished>)>,
    /// By milestones, options that reached them.
    reached: Vec<VecDeque<OptionPlace>>,
    solved: VecDeque<OptionPlace>,
    priorities: Option<ByPriority>,
}

/// What steps and options count where they are drawn by priorities; most runs draw otherwise.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct ByPriority {
    steps: Priorities,
    options: Priorities,
    /// Options of each instance that can be drawn, the latest.
    options_kept: usize,
}

impl Replay {
    /// So many states are kept of each instance.
    pub(crate) fn new(instances: usize, kept: usize, milestones: usize) -> Self {
        let widths = Widths { agents: 1, ..Widths::default() };
        Self {
            steps: Trajectories::noting(Capacity::States(kept), instances, widths),
            options: vec![(0, VecDeque::new()); instances],
            reached: vec![VecDeque::new(); milestones],
            solved: VecDeque::new(),
            priorities: None,
        }
    }

    /// The same, from which is drawn by priorities, unless their exponent is 0: so many options of each instance.
    pub(crate) fn by_priority(self, exponent: f64, options_kept: usize) -> Self {
        let priorities = (exponent > 0.0).then(|| ByPriority {
            steps: Priorities::new(self.steps.slots(), exponent),
            options: Priorities::new(self.options.len() * options_kept, exponent),
            options_kept,
        });
        Self { priorities, ..self }
    }

    pub(crate) fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.steps.visit(state)?;
        state.value("options", &mut self.options)?;
        state.value("options-reached", &mut self.reached)?;
        state.value("options-solved", &mut self.solved)?;
        self.priorities.as_mut().map_or(Ok(()), |it| state.value("priorities", it))
    }

    /// Keeps a step.
    pub(crate) fn push(&mut self, transition: &Transition<'_>, note: Note) -> Place {
        let place = self.steps.push_noted(transition, note);
        if let Some(priorities) = &mut self.priorities {
            // The state that ended an episode stands behind its last step.
            for state in 0..=usize::from(transition.step.done()) {
                priorities.steps.remove(self.steps.slot(place.after(state)));
            }
        }
        place
    }

    /// Keeps an option whose steps are there, and tells them what it reached.
    pub(crate) fn finish(&mut self, option: Finished) {
        for place in (0..option.steps.into()).map(|step| option.start.after(step)) {
            self.steps.note_mut(place).option_reached = option.reached;
            // Only now is it known what they are learned from as.
            if let Some(priorities) = &mut self.priorities {
                priorities.steps.add(self.steps.slot(place));
            }
        }
        let instance = option.start.instance();
        let (forgotten, options) = &mut self.options[instance];
        while options.front().is_some_and(|first| !self.steps.has(first.start)) {
            options.pop_front();
            *forgotten += 1;
        }
        options.push_back(option);
        let number = *forgotten + options.len() as u32 - 1;
        let place = (instance as u32, number);
        if let Some(priorities) = &mut self.priorities {
            priorities.options.add(priorities.slot(place));
        }
        if option.reached == NONE {
            return;
        }
        let task = usize::from(option.reached) + 1 == self.reached.len();
        self.add_reached(option.reached.into(), place);
        if task {
            self.add_solved(place);
        }
    }

    fn add_reached(&mut self, milestone: usize, place: OptionPlace) {
        while self.reached[milestone].front().is_some_and(|first| self.option(*first).is_none()) {
            self.reached[milestone].pop_front();
        }
        self.reached[milestone].push_back(place);
    }

    /// All options of the episode that the last one of an instance solved.
    fn add_solved(&mut self, (instance, last): OptionPlace) {
        while self.solved.front().is_some_and(|first| self.option(*first).is_none()) {
            self.solved.pop_front();
        }
        let goes_on = |number: &u32| {
            self.option((instance, *number)).is_some_and(|option| option.end == End::Open)
        };
        let first = (0..last).rev().take_while(goes_on).last().unwrap_or(last);
        self.solved.extend((first..=last).map(|number| (instance, number)));
    }

    /// An option that is still kept.
    pub(crate) fn option(&self, (instance, number): OptionPlace) -> Option<&Finished> {
        let (forgotten, options) = &self.options[instance as usize];
        let option = options.get(number.checked_sub(*forgotten)? as usize)?;
        self.steps.has(option.start).then_some(option)
    }

    /// A step and its priority: of options that are over, where there are priorities; else of an option that reached a
    /// milestone with such a chance, or any.
    pub(crate) fn draw(&self, reached: f32, random: &mut Random) -> (Place, f64) {
        let by_priority = self.priorities.as_ref().and_then(|it| it.steps.draw(random));
        if let Some((slot, priority)) = by_priority {
            return (self.steps.at(slot), priority);
        }
        let reached = chance(random, reached.into());
        let place = reached.then(|| self.draw_reached(random)).flatten();
        (place.unwrap_or_else(|| self.steps.draw(0, random)), 1.0)
    }

    /// A step of an option that reached a milestone, each as likely; none where no option did.
    fn draw_reached(&self, random: &mut Random) -> Option<Place> {
        let known = self.reached.iter().filter(|options| !options.is_empty());
        let options = known.clone().nth(below(random, known.count()))?;
        let option = self.option(options[below(random, options.len())])?;
        Some(option.start.after(below(random, option.steps.into())))
    }

    /// An option and its priority: the latest, where there are priorities; else of an episode that was solved with such a
    /// chance, or any. None where it is not kept any more.
    pub(crate) fn draw_option(
        &mut self,
        solved: f32,
        random: &mut Random,
    ) -> Option<(OptionPlace, f64)> {
        if let Some(drawn) = self.draw_option_by_priority(random) {
            return Some(drawn);
        }
        let is_solved = chance(random, solved.into()) && !self.solved.is_empty();
        let place = if is_solved {
            self.solved[below(random, self.solved.len())]
        } else {
            let instance = below(random, self.options.len());
            let (forgotten, options) = &self.options[instance];
            (instance as u32, *forgotten + below(random, options.len()) as u32)
        };
        self.option(place).map(|_| (place, 1.0))
    }

    fn draw_option_by_priority(&mut self, random: &mut Random) -> Option<(OptionPlace, f64)> {
        let priorities = self.priorities.as_ref()?;
        let (drawn, priority) = priorities.options.draw(random)?;
        let (instance, slot) = (drawn / priorities.options_kept, drawn % priorities.options_kept);
        let (forgotten, known) = &self.options[instance];
        let last = *forgotten as usize + known.len() - 1;
        // The latest that has this slot.
        let ahead = (last + priorities.options_kept - slot) % priorities.options_kept;
        let place = (instance as u32, (last - ahead) as u32);
        if self.option(place).is_some() {
            return Some((place, priority));
        }
        self.priorities.as_mut()?.options.remove(drawn);
        None
    }

    /// Tells steps how far off their values were.
    pub(crate) fn correct_steps(&mut self, errors: impl Iterator<Item = (Place, f32)>) {
        let Some(priorities) = &mut self.priorities else { return };
        for (place, error) in errors {
            priorities.steps.correct(self.steps.slot(place), error);
        }
    }

    /// The same of options.
    pub(crate) fn correct_options(&mut self, errors: impl Iterator<Item = (OptionPlace, f32)>) {
        let Some(priorities) = &mut self.priorities else { return };
        for (place, error) in errors {
            priorities.options.correct(priorities.slot(place), error);
        }
    }
}

impl ByPriority {
    /// The place of an option among those that can be drawn.
    fn slot(&self, (instance, number): OptionPlace) -> usize {
        instance as usize * self.options_kept + number as usize % self.options_kept
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::options::tests::{keep, world};

    /// Options of three steps, `steps` states of one instance of two in all.
    fn played(kept: usize, options_kept: usize, steps: u32) -> Replay {
        let mut replay = Replay::new(2, kept, 2).by_priority(0.5, options_kept);
        let (world, mut start) = (world(), Place::default());
        for time in 0..steps {
            let note = Note { reached: NONE, ends_option: time % 3 == 2, ..Note::default() };
            let place = keep(&mut replay, &*world, (1, &[time as u8]), (0, note), End::Open);
            start = if time % 3 == 0 { place } else { start };
            if note.ends_option {
                let (goal, reached) = (0, NONE);
                let option = Finished { start, steps: 3, goal, reached, mask: 3, end: End::Open };
                replay.finish(option);
            }
        }
        replay
    }

    #[test]
    fn what_is_drawn_by_priorities_is_kept_and_over() {
        let mut random = sortie_envs::random::generator(1);
        // Before a ring is full, and after it went round.
        for (steps, first, last) in [(8, 0, 5), (26, 16, 23)] {
            let replay = played(10, 100, steps);
            let draw = |_| replay.steps.state(replay.draw(0.0, &mut random).0)[0];
            let drawn: BTreeSet<_> = (0..500).map(draw).collect();
            assert!(drawn.into_iter().eq(first..=last), "{steps}");
        }
        for (options_kept, want) in [(2, [6, 7].as_slice()), (100, &[6, 7])] {
            let mut replay = played(10, options_kept, 26);
            let draw = |_| replay.draw_option_by_priority(&mut random);
            let drawn: BTreeSet<_> = (0..500).filter_map(draw).map(|it| it.0).collect();
            let want: Vec<_> = want.iter().map(|number| (1, *number)).collect();
            assert_eq!(drawn.into_iter().collect::<Vec<_>>(), want, "{options_kept}");
        }
    }

    #[test]
    fn errors_become_priorities_of_the_steps_and_options_that_had_them() {
        let mut random = sortie_envs::random::generator(1);
        let mut replay = played(10, 2, 26);
        // The first of the ten states that are kept; nothing is told of the last two yet.
        let first = replay.steps.at(10 + 16 % 10);
        let error = |time| if time == 19 { 4.0 } else { 0.0 };
        replay.correct_steps((16..24).map(|time| (first.after(time - 16), error(time))));
        replay.correct_options([((1, 6), 0.25), ((1, 7), 2.25)].into_iter());
        let priority = |error: f64| (error + 0.001).powf(0.5);
        let mut seen = [0; 2];
        for _ in 0..300 {
            let (step, found) = replay.draw(0.0, &mut random);
            let is_off = replay.steps.state(step) == [19];
            assert_eq!(found, priority(if is_off { 4.0 } else { 0.0 }));
            let (option, found) = replay.draw_option_by_priority(&mut random).unwrap();
            assert_eq!(found, priority(if option.1 == 6 { 0.25 } else { 2.25 }));
            seen[0] += usize::from(is_off);
            seen[1] += usize::from(option.1 == 7);
        }
        assert!(seen[0] > 240 && (190..260).contains(&seen[1]), "{seen:?}");
    }

    /// Every second state is one that an episode ended in, and takes the place of a step once the ring is full.
    #[test]
    fn states_in_which_nothing_was_done_are_not_drawn_by_priorities() {
        let (mut replay, world) = (Replay::new(1, 5, 2).by_priority(0.5, 3), world());
        let mut random = sortie_envs::random::generator(1);
        for number in 0..20 {
            let note = Note { reached: NONE, ends_option: true, ..Note::default() };
            let start = keep(&mut replay, &*world, (0, &[number]), (0, note), End::Over);
            let (goal, reached, end) = (0, NONE, End::Over);
            replay.finish(Finished { start, steps: 1, goal, reached, mask: 3, end });
            for _ in 0..50 {
                let place = replay.draw(0.0, &mut random).0;
                assert_eq!(replay.steps.end(place), End::Over, "{number}");
            }
        }
    }
}
