//! What observes stored states.

use std::fmt;
use std::ops::Deref;
use std::sync::Arc;

use sortie_envs::{Environment, Split};

/// An environment that nobody plays in, shared by all that look at states.
#[derive(Clone)]
pub struct Observer(Arc<dyn Environment>);

impl Observer {
    /// What observes the states of an environment.
    pub fn of(environment: &dyn Environment) -> Self {
        Self(Arc::from(environment.open(1, Split::Train)))
    }
}

impl Deref for Observer {
    type Target = dyn Environment;

    fn deref(&self) -> &Self::Target {
        &*self.0
    }
}

impl fmt::Debug for Observer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Observer").field(&self.spec().name).finish()
    }
}
