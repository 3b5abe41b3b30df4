//! What is kept: steps in rings, one for each instance, and the options that they make up.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use sortie_envs::Random;
use sortie_envs::random::{below, chance};
use sortie_learn::{LearnError, State};

use super::priorities::Priorities;

/// No milestone.
pub(crate) const NONE: u8 = u8::MAX;

/// A step of an instance: where it stands, for as long as it is kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Place {
    pub(crate) instance: u32,
    /// Number of the state since the instance began.
    pub(crate) time: u32,
}

impl Place {
    pub(crate) fn after(self, steps: u32) -> Self {
        Self { time: self.time + steps, ..self }
    }
}

/// What was done in a state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Moment {
    pub(crate) action: u8,
    pub(crate) goal: u8,
    /// The milestone that the step reached, or none.
    pub(crate) reached: u8,
    /// The milestone that the option reached; told to all of its steps when it is over.
    pub(crate) option_reached: u8,
    /// Whether the step changed nothing that is seen.
    pub(crate) changed_nothing: bool,
    /// Whether the option was over behind it.
    pub(crate) ends_option: bool,
    /// Whether nothing can follow.
    pub(crate) terminated: bool,
    /// A last state, in which nothing was done.
    pub(crate) is_last: bool,
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
    pub(crate) end: End,
}

/// How an option left its episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum End {
    /// The next option follows in the list of the instance.
    GoesOn,
    /// The task was fulfilled, or nothing can be reached any more.
    Terminated,
    /// The time ran out.
    TimedOut,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Ring {
    /// States so far.
    count: u32,
    shown: Vec<u8>,
    moments: Vec<Moment>,
}

/// An option by its instance and its number there.
pub(crate) type OptionPlace = (u32, u32);

/// Everything that is kept.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Replay {
    bytes: usize,
    /// States kept of each instance.
    kept: usize,
    rings: Vec<Ring>,
    /// Of each instance, with how many were forgotten before.
    options: Vec<(u32, VecDeque<Finished>)>,
    /// By milestones, options that reached them.
    reached: Vec<VecDeque<OptionPlace>>,
    /// Options of episodes that were solved.
    solved: VecDeque<OptionPlace>,
    /// Of steps and of options, where they are drawn by priorities; files have them apart, most runs have none.
    #[serde(skip)]
    priorities: Option<ByPriority>,
}

/// What steps and options count where they are drawn.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct ByPriority {
    steps: Priorities,
    options: Priorities,
    /// Options of each instance that can be drawn, the latest.
    options_kept: usize,
}

impl Replay {
    pub(crate) fn new(instances: usize, kept: usize, bytes: usize, milestones: usize) -> Self {
        Self {
            bytes,
            kept,
            rings: vec![Ring::default(); instances],
            options: vec![(0, VecDeque::new()); instances],
            reached: vec![VecDeque::new(); milestones],
            solved: VecDeque::new(),
            priorities: None,
        }
    }

    /// The same, from which is drawn by priorities: so many options of each instance.
    pub(crate) fn by_priority(self, exponent: f64, options_kept: usize) -> Self {
        let places = |kept: usize| Priorities::new(self.rings.len() * kept, exponent);
        let priorities =
            ByPriority { steps: places(self.kept), options: places(options_kept), options_kept };
        Self { priorities: Some(priorities), ..self }
    }

    pub(crate) fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        let mut priorities = self.priorities.take();
        state.value("replay", self)?;
        if let Some(priorities) = &mut priorities {
            state.value("priorities", priorities)?;
        }
        self.priorities = priorities;
        Ok(())
    }

    /// Keeps a state and what was done in it.
    pub(crate) fn push(&mut self, instance: usize, shown: &[u8], moment: Moment) -> Place {
        let (bytes, kept) = (self.bytes, self.kept);
        let ring = &mut self.rings[instance];
        let place = ring.count as usize % kept;
        if place == ring.moments.len() {
            ring.shown.extend_from_slice(shown);
            ring.moments.push(moment);
        } else {
            ring.shown[place * bytes..][..bytes].copy_from_slice(shown);
            ring.moments[place] = moment;
        }
        ring.count += 1;
        if let Some(priorities) = &mut self.priorities {
            priorities.steps.remove(instance * kept + place);
        }
        Place { instance: instance as u32, time: ring.count - 1 }
    }

    /// Whether a state is still kept.
    pub(crate) fn has(&self, place: Place) -> bool {
        let count = self.rings[place.instance as usize].count;
        place.time < count && (count - place.time) as usize <= self.kept
    }

    pub(crate) fn shown(&self, place: Place) -> &[u8] {
        let at = place.time as usize % self.kept * self.bytes;
        &self.rings[place.instance as usize].shown[at..][..self.bytes]
    }

    pub(crate) fn moment(&self, place: Place) -> Moment {
        self.rings[place.instance as usize].moments[place.time as usize % self.kept]
    }

    /// Keeps an option whose steps are there, and tells them what it reached.
    pub(crate) fn finish(&mut self, option: Finished) {
        let instance = option.start.instance as usize;
        for step in 0..u32::from(option.steps) {
            let place = option.start.after(step).time as usize % self.kept;
            self.rings[instance].moments[place].option_reached = option.reached;
            // Only now is it known what they are learned from as.
            if let Some(priorities) = &mut self.priorities {
                priorities.steps.add(instance * self.kept + place);
            }
        }
        while self.options[instance].1.front().is_some_and(|first| !self.has(first.start)) {
            self.options[instance].1.pop_front();
            self.options[instance].0 += 1;
        }
        let (forgotten, options) = &mut self.options[instance];
        options.push_back(option);
        let number = *forgotten + options.len() as u32 - 1;
        let place = (instance as u32, number);
        if let Some(ByPriority { options, options_kept, .. }) = &mut self.priorities {
            options.add(instance * *options_kept + number as usize % *options_kept);
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
            self.option((instance, *number)).is_some_and(|option| option.end == End::GoesOn)
        };
        let first = (0..last).rev().take_while(goes_on).last().unwrap_or(last);
        self.solved.extend((first..=last).map(|number| (instance, number)));
    }

    /// An option that is still kept.
    pub(crate) fn option(&self, (instance, number): OptionPlace) -> Option<&Finished> {
        let (forgotten, options) = &self.options[instance as usize];
        let option = options.get(number.checked_sub(*forgotten)? as usize)?;
        self.has(option.start).then_some(option)
    }

    /// A step of an option that is over, by priorities, and its own.
    pub(crate) fn draw_step_by_priority(&self, random: &mut Random) -> Option<(Place, f64)> {
        let steps = &self.priorities.as_ref()?.steps;
        let drawn = steps.draw(random)?;
        let (instance, place) = (drawn / self.kept, drawn % self.kept);
        let time = latest(self.rings[instance].count as usize, self.kept, place);
        Some((Place { instance: instance as u32, time }, steps.of(drawn)))
    }

    /// An option by priorities, and its own.
    pub(crate) fn draw_option_by_priority(
        &mut self,
        random: &mut Random,
    ) -> Option<(OptionPlace, f64)> {
        let ByPriority { options, options_kept, .. } = self.priorities.as_ref()?;
        let drawn = options.draw(random)?;
        let (instance, place) = (drawn / options_kept, drawn % options_kept);
        let (forgotten, known) = &self.options[instance];
        let option =
            (instance as u32, latest(*forgotten as usize + known.len(), *options_kept, place));
        let priority = options.of(drawn);
        if self.option(option).is_none()
            && let Some(priorities) = &mut self.priorities
        {
            priorities.options.remove(drawn);
            return None;
        }
        Some((option, priority))
    }

    /// Tells steps how far off their values were.
    pub(crate) fn correct_steps(&mut self, errors: impl Iterator<Item = (Place, f32)>) {
        let Some(priorities) = &mut self.priorities else { return };
        for (Place { instance, time }, error) in errors {
            let place = instance as usize * self.kept + time as usize % self.kept;
            priorities.steps.correct(place, error);
        }
    }

    /// The same of options.
    pub(crate) fn correct_options(&mut self, errors: impl Iterator<Item = (OptionPlace, f32)>) {
        let Some(ByPriority { options, options_kept, .. }) = &mut self.priorities else { return };
        for ((instance, number), error) in errors {
            let place = instance as usize * *options_kept + number as usize % *options_kept;
            options.correct(place, error);
        }
    }

    /// A step and its priority: by priorities where there are any, else of an option that reached a milestone with such a
    /// chance, or any.
    pub(crate) fn draw(&self, reached: f32, random: &mut Random) -> (Place, f64) {
        self.draw_step_by_priority(random).unwrap_or_else(|| {
            let reached = chance(random, reached.into());
            let place = reached.then(|| self.draw_reached(random)).flatten();
            (place.unwrap_or_else(|| self.draw_step(random)), 1.0)
        })
    }

    /// A step that something was done in, any of those that are kept.
    fn draw_step(&self, random: &mut Random) -> Place {
        loop {
            let instance = below(random, self.rings.len());
            let ring = &self.rings[instance];
            let last = ring.count - 1 - below(random, ring.moments.len()) as u32;
            let place = Place { instance: instance as u32, time: last };
            if !self.moment(place).is_last {
                return place;
            }
        }
    }

    /// A step of an option that reached a milestone, each as likely; none where no option did.
    fn draw_reached(&self, random: &mut Random) -> Option<Place> {
        let known = self.reached.iter().filter(|options| !options.is_empty());
        let options = known.clone().nth(below(random, known.count()))?;
        let option = self.option(options[below(random, options.len())])?;
        Some(option.start.after(below(random, option.steps.into()) as u32))
    }

    /// An option, any of those that are kept, of a solved episode where that is wanted.
    pub(crate) fn draw_option(&self, is_solved: bool, random: &mut Random) -> Option<OptionPlace> {
        let place = if is_solved {
            *self.solved.get(below(random, self.solved.len()))?
        } else {
            let instance = below(random, self.options.len());
            let (forgotten, options) = &self.options[instance];
            (instance as u32, *forgotten + below(random, options.len()) as u32)
        };
        self.option(place).map(|_| place)
    }
}

/// The latest of so many numbers that stands at a place of a ring.
fn latest(count: usize, kept: usize, place: usize) -> u32 {
    let last = count - 1;
    (last - (last % kept + kept - place) % kept) as u32
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    /// Options of three steps, `steps` states of one instance of two in all.
    fn played(kept: usize, options_kept: usize, steps: u32) -> Replay {
        let mut replay = Replay::new(2, kept, 1, 2).by_priority(0.5, options_kept);
        for time in 0..steps {
            let moment = Moment { reached: NONE, ends_option: time % 3 == 2, ..Moment::default() };
            replay.push(1, &[time as u8], moment);
            if time % 3 == 2 {
                let start = Place { instance: 1, time: time - 2 };
                let (goal, reached) = (0, NONE);
                let option = Finished { start, steps: 3, goal, reached, mask: 3, end: End::GoesOn };
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
            let draw = |_| replay.draw_step_by_priority(&mut random).unwrap().0;
            let drawn: BTreeSet<_> = (0..500).map(draw).map(|it| (it.instance, it.time)).collect();
            let want: Vec<_> = (first..=last).map(|time| (1, time)).collect();
            assert_eq!(drawn.into_iter().collect::<Vec<_>>(), want, "{steps}");
        }
        for (options_kept, want) in [(2, [6, 7].as_slice()), (100, &[6, 7])] {
            let mut replay = played(10, options_kept, 26);
            let draw = |_| replay.draw_option_by_priority(&mut random);
            let drawn: BTreeSet<_> = (0..500).filter_map(draw).map(|it| it.0).collect();
            let want: Vec<_> = want.iter().map(|number| (1, *number)).collect();
            assert_eq!(drawn.into_iter().collect::<Vec<_>>(), want, "{options_kept}");
        }
        assert!(Replay::new(2, 10, 1, 2).draw_step_by_priority(&mut random).is_none());
    }

    #[test]
    fn errors_become_priorities_of_the_steps_and_options_that_had_them() {
        let mut random = sortie_envs::random::generator(1);
        let mut replay = played(10, 2, 26);
        let place = |time| Place { instance: 1, time };
        replay
            .correct_steps((16..24).map(|time| (place(time), if time == 19 { 4.0 } else { 0.0 })));
        replay.correct_options([((1, 6), 0.25), ((1, 7), 2.25)].into_iter());
        let priority = |error: f64| (error + 0.001).powf(0.5);
        let mut seen = [0; 2];
        for _ in 0..300 {
            let (step, found) = replay.draw_step_by_priority(&mut random).unwrap();
            assert_eq!(found, priority(if step.time == 19 { 4.0 } else { 0.0 }));
            let (option, found) = replay.draw_option_by_priority(&mut random).unwrap();
            assert_eq!(found, priority(if option.1 == 6 { 0.25 } else { 2.25 }));
            seen[0] += usize::from(step.time == 19);
            seen[1] += usize::from(option.1 == 7);
        }
        assert!(seen[0] > 240 && (190..260).contains(&seen[1]), "{seen:?}");
    }
}
