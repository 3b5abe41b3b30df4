//! Which bundle a team decides by, and which it may change to: what survives the death of any process.

use serde::{Deserialize, Serialize};

/// A model's id in messages, as it is written: 32 hexadecimal digits.
pub fn model_text(model: [u8; 16]) -> String {
    format!("{:032x}", u128::from_be_bytes(model))
}

/// A bundle as a team knows it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TeamBundle {
    /// The name of its folder, by which processes find it beside their own; empty where it has none that may travel.
    pub name: String,
    /// First 16 bytes of its id, hexadecimal; empty while it is not in use.
    pub model: String,
}

/// The two bundles of a team. Generations take turns: those of even number decide by the one, of odd number by the other.
///
/// So the bundle before a change stays in memory beside the one after it, and turning back is one more change.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TeamBundles {
    /// How often the team has changed its bundle.
    generation: u16,
    even: TeamBundle,
    odd: TeamBundle,
}

impl TeamBundles {
    /// Those of a team that has changed nothing yet.
    pub fn new(bundle: TeamBundle) -> Self {
        Self { generation: 0, even: bundle, odd: TeamBundle::default() }
    }

    /// How often the team has changed its bundle; it wraps.
    pub fn generation(&self) -> u16 {
        self.generation
    }

    /// The bundle of a generation: the one in use, or of a neighbour.
    pub fn of(&self, generation: u16) -> &TeamBundle {
        if generation.is_multiple_of(2) { &self.even } else { &self.odd }
    }

    /// The bundle in use.
    pub fn in_use(&self) -> &TeamBundle {
        self.of(self.generation)
    }

    /// The bundle that the team may change to, or turn back to; its name is empty where there is none.
    pub fn other(&self) -> &TeamBundle {
        self.of(self.next())
    }

    /// The generation after this one.
    pub fn next(&self) -> u16 {
        self.generation.wrapping_add(1)
    }

    /// Notes what the team may change to next.
    pub fn prepare(&mut self, name: &str) {
        *self.other_mut() = TeamBundle { name: name.to_string(), model: String::new() };
    }

    /// Changes to the other bundle, whose id is `model`.
    pub fn change(&mut self, model: &str) {
        self.other_mut().model = model.to_string();
        self.generation = self.next();
    }

    fn other_mut(&mut self) -> &mut TeamBundle {
        if self.next().is_multiple_of(2) { &mut self.even } else { &mut self.odd }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bundle_before_a_change_is_the_one_to_turn_back_to() {
        let bundle = |name: &str| TeamBundle { name: name.into(), model: format!("id of {name}") };
        let mut bundles = TeamBundles::new(bundle("a"));
        bundles.prepare("b");
        assert_eq!((bundles.in_use().name.as_str(), bundles.other().name.as_str()), ("a", "b"));
        assert_eq!(bundles.other().model, "");
        bundles.change("id of b");
        assert_eq!((bundles.generation(), bundles.in_use()), (1, &bundle("b")));
        bundles.change("id of a");
        assert_eq!(
            (bundles.generation(), bundles.in_use(), bundles.other()),
            (2, &bundle("a"), &bundle("b"))
        );
        bundles.prepare("c");
        assert_eq!((bundles.in_use(), bundles.other().name.as_str()), (&bundle("a"), "c"));
    }

    #[test]
    fn generations_take_turns_past_the_last_number() {
        let mut bundles = TeamBundles::new(TeamBundle::default());
        for expected in 1..=70_000_u32 {
            let next = bundles.other().clone();
            bundles.change("x");
            assert_eq!(u32::from(bundles.generation()), expected % 65_536);
            assert_eq!(bundles.in_use().name, next.name);
        }
    }
}
