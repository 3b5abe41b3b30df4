//! A policy whoever exported it, in any engine.

use sortie_plans::{CompileError, FlatPolicy, OutputRole, PolicyAnswer, PolicyFacts};

use super::Opens;
use crate::engine::{AnyEngine, Engine, Named};
use crate::flat::{FlatGraph, Interface, other_values};

/// A policy that runs its graph.
#[derive(Debug)]
pub(crate) struct GraphFlatPolicy {
    engine: AnyEngine,
    interface: Interface,
    /// The states of [`FlatPolicy::step`].
    states: Vec<f32>,
}

impl GraphFlatPolicy {
    pub(crate) fn open<O: Opens>(graph: FlatGraph, opener: &O) -> Result<Self, CompileError>
    where
        O::Engine: Engine<Number = f32>,
    {
        let engine: AnyEngine = Box::new(opener.open_policy(&graph)?);
        let interface = graph.interface;
        let states = vec![0.0; interface.facts.state_length()];
        Ok(Self { engine, interface, states })
    }
}

/// All outputs of the cut file.
fn outputs(
    engine: &mut AnyEngine,
    interface: &Interface,
    inputs: &[&[f32]],
    states: &[f32],
) -> Result<Vec<Vec<f32>>, CompileError> {
    let arranged = interface.arranged(inputs, states)?;
    let named: Vec<Named<'_, f32>> = arranged.into_iter().map(Named::from).collect();
    engine.run(&named)
}

impl FlatPolicy for GraphFlatPolicy {
    fn facts(&self) -> &PolicyFacts {
        &self.interface.facts
    }

    fn run(
        &mut self,
        inputs: &[&[f32]],
        states: &mut [f32],
    ) -> Result<Vec<PolicyAnswer>, CompileError> {
        let given = outputs(&mut self.engine, &self.interface, inputs, states)?;
        self.interface.answers(&given, states)
    }

    fn step(&mut self, inputs: &[&[f32]]) -> Result<(), CompileError> {
        let Self { engine, interface, states } = self;
        let given = outputs(engine, interface, inputs, states)?;
        let next = interface.facts.outputs.iter().zip(&given);
        let next = next.filter(|(output, _)| output.role == OutputRole::State);
        let mut rest = states.as_mut_slice();
        for (output, from) in next {
            let to = rest.split_off_mut(..output.length()).filter(|to| to.len() == from.len());
            to.ok_or_else(other_values)?.copy_from_slice(from);
        }
        Ok(())
    }
}
