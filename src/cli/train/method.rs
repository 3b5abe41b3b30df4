//! The methods by their names.

use std::sync::LazyLock;

use clap::ValueEnum;
use clap::builder::PossibleValue;
use sortie_learn::session::MethodEntry;
use sortie_methods::METHODS;

/// What learns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Method(pub(super) &'static MethodEntry);

impl ValueEnum for Method {
    fn value_variants<'a>() -> &'a [Self] {
        static ALL: LazyLock<Vec<Method>> = LazyLock::new(|| METHODS.iter().map(Method).collect());
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.0.name).help(self.0.about))
    }
}
