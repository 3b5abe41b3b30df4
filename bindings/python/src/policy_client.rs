//! `sortie.PolicyClient`: the robot's side of a policy that another process serves.

use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use pyo3::exceptions::{PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use serde_json::json;
use sortie_core::plan::{Normaliser, RobotFacts, Trip};
use sortie_core::wire::{AnswerStatus, Reason};
use sortie_ipc::{
    AnyThread, ClientCounters, ClientSettings, Domain, Error, Expected, Fallback, PolicySchema,
    Port,
};

use crate::arrays::{array, mask, numbers, slice};
use crate::compiler::to_python;
use crate::errors::of_service;
use crate::interface::{Asked, Interface};

type Client = sortie_ipc::PolicyClient<AnyThread>;

/// How long a server is waited for before Python looks for signals.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// The longest time that somebody can ask for, in seconds.
const LONGEST: f64 = 1e6;

/// A connection to the server of a domain.
#[pyclass(frozen, module = "sortie")]
pub(crate) struct PolicyClient {
    /// None once it is closed.
    client: Mutex<Option<Client>>,
    /// A copy, for whoever looks on while a decision is waited for.
    counters: Mutex<ClientCounters>,
    schema: PolicySchema,
    interface: Interface,
    domain: String,
}

/// What a robot is to do.
#[pyclass(frozen, get_all, module = "sortie")]
pub(crate) struct Action {
    /// `answered`, `late` or `fallback`.
    status: &'static str,
    /// Why it is the fallback.
    reason: Option<&'static str>,
    /// The guard that tripped.
    guard: Option<&'static str>,
    /// Which input or output it tripped at.
    guard_index: Option<u32>,
    /// The action, where the policy chooses one.
    action: Option<u16>,
    /// The output, or a dict of several by name.
    outputs: Py<PyAny>,
    /// The server began within the episode with a new recurrent state.
    lost_state: bool,
}

#[pymethods]
impl PolicyClient {
    #[new]
    #[pyo3(signature = (domain, *, inputs=None, outputs=None, actions=None, robot=None, deadline=None, fallback=None, patience=10.0, linger=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        py: Python<'_>,
        domain: &str,
        inputs: Option<&Bound<'_, PyDict>>,
        outputs: Option<&Bound<'_, PyDict>>,
        actions: Option<usize>,
        robot: Option<&Bound<'_, PyDict>>,
        deadline: Option<f64>,
        fallback: Option<&Bound<'_, PyAny>>,
        patience: f64,
        linger: Option<f64>,
    ) -> PyResult<Self> {
        let seconds = |name, time: Option<f64>| time.map(|time| duration(name, time)).transpose();
        let settings = ClientSettings {
            deadline: seconds("deadline", deadline)?,
            fallback: fallback.map(fallback_of).transpose()?,
            patience: duration("patience", patience)?,
            linger: seconds("linger", linger)?,
        };
        let robot = robot.map(stated).transpose()?.unwrap_or_default();
        let domain = Domain::new(domain).map_err(of_service)?;
        let client = connect(py, &domain, &settings)?;
        let schema = client.schema().clone();
        let inputs = ports(inputs, &schema.inputs)?;
        let outputs = ports(outputs, &schema.outputs)?;
        let expected = Expected {
            inputs: &inputs.iter().map(borrowed).collect::<Vec<_>>(),
            outputs: &outputs.iter().map(borrowed).collect::<Vec<_>>(),
            actions: actions.unwrap_or(schema.actions),
        };
        schema.check(&domain, &expected).map_err(of_service)?;
        schema.check_robot(&domain, &robot).map_err(of_service)?;
        let interface = Interface::of_served(&inputs, &outputs, &schema);
        Ok(Self {
            client: Mutex::new(Some(client)),
            counters: Mutex::default(),
            schema,
            interface,
            domain: domain.id().to_owned(),
        })
    }

    /// What to do on these inputs: at the deadline at the latest.
    #[pyo3(signature = (*inputs, available=None, **named))]
    fn decide(
        &self,
        inputs: &Bound<'_, PyTuple>,
        available: Option<&Bound<'_, PyAny>>,
        named: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Action> {
        let py = inputs.py();
        let given = self.given(inputs, named)?;
        let available = self.available(available)?;
        let mut place = self.place()?;
        let client = place.as_mut().ok_or_else(closed)?;
        let mut signal = None;
        let decided = py.detach(|| {
            let given: Vec<&[f32]> = given.iter().map(Vec::as_slice).collect();
            let mut goes_on = || {
                Python::attach(|py| py.check_signals())
                    .map_err(|raised| signal = Some(raised))
                    .is_ok()
            };
            client.decide_while(&given, &available, &mut goes_on).map(Decided::from)
        });
        let counters = client.counters();
        drop(place);
        *self.counters.lock().unwrap_or_else(PoisonError::into_inner) = counters;
        if let Some(signal) = signal {
            return Err(signal);
        }
        self.action(py, &decided.map_err(of_service)?)
    }

    /// The next observation begins an episode: the recurrent state starts anew.
    fn begin_episode(&self) -> PyResult<()> {
        self.place()?.as_mut().ok_or_else(closed).map(Client::begin_episode)
    }

    /// Waits so many seconds for every answer from now on.
    fn set_deadline(&self, deadline: f64) -> PyResult<()> {
        let deadline = duration("deadline", deadline)?;
        self.place()?.as_mut().ok_or_else(closed).map(|client| client.set_deadline(deadline))
    }

    /// What happened since the start.
    #[getter]
    fn counters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let counters = *self.counters.lock().unwrap_or_else(PoisonError::into_inner);
        let ClientCounters {
            answered,
            late,
            fallbacks,
            guarded,
            clamped,
            silent,
            overdue,
            foreign,
            lost_states,
        } = counters;
        let report = json!({
            "answered": answered,
            "late": late,
            "fallbacks": fallbacks,
            "guarded": guarded,
            "clamped": clamped,
            "silent": silent,
            "overdue": overdue,
            "foreign": foreign,
            "lost_states": lost_states,
        });
        to_python(py, &report)
    }

    /// What the policy takes and gives.
    #[getter]
    fn schema<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &json!(self.schema))
    }

    /// Leaves the domain; another robot may come.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let client = self.place()?.take();
        // Leaving waits for others that start or leave.
        py.detach(|| drop(client));
        Ok(())
    }

    fn __enter__(this: Py<Self>) -> Py<Self> {
        this
    }

    fn __exit__(
        &self,
        py: Python<'_>,
        _kind: &Bound<'_, PyAny>,
        _raised: &Bound<'_, PyAny>,
        _trace: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        self.close(py)
    }

    fn __repr__(&self) -> String {
        format!("<sortie.PolicyClient {}: {}>", self.domain, self.interface.summary())
    }
}

#[pymethods]
impl Action {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let Self { status, reason, guard, guard_index, action, outputs, .. } = self;
        let reason = reason.map_or_else(String::new, |reason| format!(" ({reason})"));
        let index = guard_index.map_or_else(String::new, |index| format!(" {index}"));
        let guard = guard.map_or_else(String::new, |guard| format!(" [{guard}{index}]"));
        let action = action.map_or_else(String::new, |action| format!(" action {action}"));
        Ok(format!("<sortie.Action {status}{reason}{guard}:{action} {}>", outputs.bind(py).repr()?))
    }
}

/// What came of a decision, apart from its client.
struct Decided {
    status: AnswerStatus,
    reason: Reason,
    guard: Option<Trip>,
    action: Option<u16>,
    outputs: Vec<f32>,
    lost_state: bool,
}

impl From<sortie_ipc::Action<'_>> for Decided {
    fn from(action: sortie_ipc::Action<'_>) -> Self {
        let sortie_ipc::Action { status, reason, guard, action, outputs, lost_state } = action;
        Self { status, reason, guard, action, outputs: outputs.to_vec(), lost_state }
    }
}

impl PolicyClient {
    /// The client, for one call at a time: an observation that overtakes another is none of the same robot.
    fn place(&self) -> PyResult<MutexGuard<'_, Option<Client>>> {
        match self.client.try_lock() {
            Ok(place) => Ok(place),
            Err(TryLockError::Poisoned(place)) => Ok(place.into_inner()),
            Err(TryLockError::WouldBlock) => {
                Err(PyRuntimeError::new_err("another call of this client is under way"))
            }
        }
    }

    /// Copies of the inputs, in the policy's order: others may write to the arrays meanwhile.
    fn given(
        &self,
        inputs: &Bound<'_, PyTuple>,
        named: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Vec<Vec<f32>>> {
        let given = self.interface.collect(inputs, named, Asked::Everything)?;
        let copy = |(input, given): (&sortie_plans::PolicyInput, Option<Bound<'_, PyAny>>)| {
            let given = given.ok_or_else(|| self.interface.misfit(Asked::Everything))?;
            let numbers = numbers(&input.name, &given)?;
            let (numbers, wanted) = (slice(&numbers)?, input.length());
            if numbers.len() != wanted {
                let got = numbers.len();
                return Err(PyValueError::new_err(format!(
                    "`{}` has {got} numbers, needed are {wanted}",
                    input.name
                )));
            }
            Ok(numbers.to_vec())
        };
        self.interface.given.iter().zip(given).map(copy).collect()
    }

    /// The mask of available actions; everything where none was given.
    fn available(&self, available: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<u16>> {
        match (available, self.schema.actions) {
            (None, actions) => Ok(vec![1; actions]),
            (Some(_), 0) => Err(PyTypeError::new_err(
                "the policy does not choose among actions: `available` is of no use",
            )),
            (Some(available), actions) => mask("available", available, &[actions]),
        }
    }

    fn action(&self, py: Python<'_>, decided: &Decided) -> PyResult<Action> {
        let Decided { status, reason, guard, action, outputs, lost_state } = decided;
        let mut rest = outputs.as_slice();
        let mut next = |length: usize| rest.split_off(..length).unwrap_or_default();
        let outputs = match self.interface.wanted.as_slice() {
            [output] => array(py, &output.shape, next(output.length()))?.into_any(),
            several => {
                let named = PyDict::new(py);
                for output in several {
                    named
                        .set_item(&output.name, array(py, &output.shape, next(output.length()))?)?;
                }
                named.into_any()
            }
        };
        Ok(Action {
            status: status_name(*status),
            reason: reason_name(*reason),
            guard: guard.map(Trip::name),
            guard_index: guard.and_then(Trip::index),
            action: *action,
            outputs: outputs.unbind(),
            lost_state: *lost_state,
        })
    }
}

/// Waits for a server; Ctrl-C ends that.
fn connect(py: Python<'_>, domain: &Domain, settings: &ClientSettings) -> PyResult<Client> {
    let until = Instant::now() + settings.patience;
    loop {
        let patience = LOOK_EVERY.min(until.saturating_duration_since(Instant::now()));
        let settings = ClientSettings { patience, ..*settings };
        match py.detach(|| Client::connect_for_threads(domain, &settings)) {
            Err(Error::NoServer { .. }) if Instant::now() < until => py.check_signals()?,
            connected => return connected.map_err(of_service),
        }
    }
}

/// The names and lengths that somebody expects; where nothing was said, those that there are.
fn ports(given: Option<&Bound<'_, PyDict>>, own: &[Port]) -> PyResult<Vec<(String, usize)>> {
    let Some(given) = given else {
        return Ok(own.iter().map(|port| (port.name.clone(), port.length)).collect());
    };
    given.iter().map(|(name, length)| Ok((name.extract()?, length.extract()?))).collect()
}

/// What somebody states of a robot. A word that is none would be a check that is never made.
fn stated(robot: &Bound<'_, PyDict>) -> PyResult<RobotFacts> {
    let mut facts = RobotFacts::default();
    for (name, value) in robot {
        let name: String = name.extract()?;
        match name.as_str() {
            "joint_names" => facts.joint_names = value.extract()?,
            "default_joint_pos" => facts.default_joint_pos = value.extract()?,
            "action_scale" => facts.action_scale = value.extract()?,
            "stiffness" => facts.stiffness = value.extract()?,
            "damping" => facts.damping = value.extract()?,
            "observation_names" => facts.observation_names = value.extract()?,
            "normaliser" => facts.normaliser = normaliser(&value.extract::<String>()?)?,
            _ => return Err(PyValueError::new_err(format!("`robot` has no `{name}`"))),
        }
    }
    Ok(facts)
}

fn normaliser(name: &str) -> PyResult<Normaliser> {
    match name {
        "file" => Ok(Normaliser::File),
        "none" => Ok(Normaliser::None),
        "unknown" => Ok(Normaliser::Unknown),
        _ => Err(PyValueError::new_err("`normaliser` is \"file\", \"none\" or \"unknown\"")),
    }
}

fn borrowed((name, length): &(String, usize)) -> (&str, usize) {
    (name, *length)
}

fn duration(name: &str, seconds: f64) -> PyResult<Duration> {
    match seconds {
        0.0..=LONGEST => Ok(Duration::from_secs_f64(seconds)),
        _ => Err(PyValueError::new_err(format!(
            "`{name}` is a number of seconds, from 0 to {LONGEST:.0}"
        ))),
    }
}

fn fallback_of(given: &Bound<'_, PyAny>) -> PyResult<Fallback> {
    given
        .str()?
        .to_str()?
        .parse()
        .map_err(|words: &str| PyValueError::new_err(format!("`fallback`: {words}")))
}

fn closed() -> PyErr {
    PyValueError::new_err("this client is closed")
}

fn status_name(status: AnswerStatus) -> &'static str {
    match status {
        AnswerStatus::Answered => "answered",
        AnswerStatus::Late => "late",
        // What the server refuses is the client's own fallback.
        AnswerStatus::Refused | AnswerStatus::Fallback => "fallback",
    }
}

fn reason_name(reason: Reason) -> Option<&'static str> {
    match reason {
        Reason::None => None,
        Reason::Foreign => Some("foreign"),
        Reason::Length => Some("length"),
        Reason::NonFinite => Some("non_finite"),
        Reason::NoAvailableAction => Some("no_available_action"),
        Reason::Policy => Some("policy"),
        Reason::Silence => Some("silence"),
        Reason::Guard => Some("guard"),
    }
}
