//! The algorithms by their names.

use std::sync::LazyLock;

use clap::ValueEnum;
use clap::builder::PossibleValue;
use sortie_learn::session::MethodEntry;
use sortie_methods::METHODS;

/// What learns.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Method {
    /// ALMA and its variants.
    Alma(AlmaMethod),
    /// A method that learns in any environment.
    Any(&'static MethodEntry),
}

/// ALMA and its variants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum AlmaMethod {
    /// Subtask-masked utilities under an allocation (dissertation chapter 7)
    Alma,
    /// The same without subtasks: everybody sees everything and earns the whole team's reward
    Flat,
    /// Flat agents and a coach that sees everything and tells each of them a strategy now and then; learned
    /// from windows by either preset
    Copa,
}

impl AlmaMethod {
    /// As `train.toml` has it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Alma => "alma",
            Self::Flat => "flat",
            Self::Copa => "copa",
        }
    }
}

impl Method {
    /// As `train.toml` has it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Alma(method) => method.name(),
            Self::Any(entry) => entry.name,
        }
    }
}

impl ValueEnum for Method {
    fn value_variants<'a>() -> &'a [Self] {
        static ALL: LazyLock<Vec<Method>> = LazyLock::new(|| {
            let alma = AlmaMethod::value_variants().iter().copied().map(Method::Alma);
            alma.chain(METHODS.iter().map(Method::Any)).collect()
        });
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        match self {
            Self::Alma(method) => method.to_possible_value(),
            Self::Any(entry) => Some(PossibleValue::new(entry.name).help(entry.about)),
        }
    }
}
