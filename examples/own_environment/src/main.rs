//! Two shipped methods learn an environment of one's own: agents of VDN point at what they work at, ALMA learns besides who is
//! sent where.

mod yard;

use std::error::Error;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use sortie_envs::random::generator;
use sortie_envs::{Environment, conformance};
use sortie_learn::Act;
use sortie_learn::draft::{MethodRun, draft_method};
use sortie_learn::play;
use sortie_learn::run::{RunConfig, RunDescription};
use sortie_learn::session::{EnvironmentChoice, Opening, Session};
use sortie_learn::subtasks::RuleAllocator;
use sortie_pages::{Canvas, Heading, Scene, TeamLog, draw, page, play};

use yard::Yard;

/// Small networks and batches, which are enough here and learned in seconds.
const SMALL: &[&str] = &["network.width=32", "replay.batch=64", "exploration.steps=10_000"];

/// Has a method learn the environment, by its preset `fast` as it suits it, with other values of some keys.
fn learn(method: &str, assignments: &[&str], folder: &Path) -> Result<Session, Box<dyn Error>> {
    let yard = || Box::new(Yard::new(1));
    let entry = sortie_methods::find(method).ok_or("no such method")?;
    let mut setup = entry.preset("fast")?;
    (entry.suit)("fast", &mut setup, yard().spec());
    setup.environment = EnvironmentChoice::of(&*yard(), 16);
    setup.run = RunConfig { steps: 40_000, evaluate_every: 10_000, final_episodes: 0, ..setup.run };
    entry.fit_to_length(&mut setup, |_| false);
    for assignment in assignments {
        setup = entry.set(&setup, assignment)?;
    }
    let description = RunDescription::new(setup, 1, 1);
    let (setup, environment) = (&description.config, &*yard());
    let method = entry.method(&Opening { setup, environment, seed: 1, threads: 1 })?;
    let mut session = Session::begin(description.clone(), yard(), method, folder)?;
    session.run(&mut (), &AtomicBool::new(false))?;
    Ok(session)
}

/// The first state in the terminal, and a page of the episode that a team plays: both are drawn from `Yard::picture`.
fn look(yard: &Yard, team: &mut dyn Act) -> Result<String, Box<dyn Error>> {
    let (mut world, mut state) = (Yard::new(1), Vec::new());
    world.reset(0, &mut generator(1));
    world.save(0, &mut state);
    let picture = &world.picture(&state);
    let scene = Scene { spec: yard.spec(), picture, allocation: &[], actions: &[] };
    let drawing = draw(&scene, Canvas { width: 79, lines: 20, is_unicode: true });
    println!("{}\n{}", drawing.lines.join("\n"), drawing.legend);
    let heading = Heading { subject: "VDN".into(), env: "yard".into(), ..Heading::default() };
    let played = play(yard, 1, 0, TeamLog::new(team, u32::MAX, None))?;
    Ok(page(&heading, &played))
}

fn main() -> Result<(), Box<dyn Error>> {
    let yard = &Yard::new(1);
    conformance::check(yard, 1, 20)?;
    let folder = std::env::temp_dir().join(format!("own-environment-{}", std::process::id()));
    let measured = |team: &mut dyn Act| play::evaluate(yard, team, 1000, 2);
    let by_chance = measured(&mut play::RandomTeam::new(1))?.return_mean;

    let vdn = learn("vdn", SMALL, &folder.join("vdn"))?;
    let alone = measured(&mut *vdn.method().team())?.return_mean;
    println!("cleared: {by_chance:.2} at random, {alone:.2} learned by VDN");

    let page = folder.join("episode.html");
    std::fs::write(&page, look(yard, &mut *vdn.method().team())?)?;
    println!("an episode to look at: {}", page.display());

    let alma = learn("alma", &[SMALL, &["allocation.interval=3"]].concat(), &folder.join("alma"))?;
    let allocated = measured(&mut *alma.method().team())?.return_mean;
    print!("cleared: {allocated:.2} under the allocator that ALMA learned");
    for rule in &yard.spec().rules {
        let agents = alma.method().subtasks().ok_or("it has no subtasks")?;
        let mut team = agents.under(Box::new(RuleAllocator(&rule.name)));
        print!(", {:.2} under the rule `{}`", measured(&mut team)?.return_mean, rule.name);
    }
    println!();

    for (name, session) in [("vdn", &vdn), ("alma", &alma)] {
        let (method, curve) = (session.method(), session.curve());
        let run =
            MethodRun { description: session.description(), environment: yard, method, curve };
        let place = folder.join(name);
        let bundle = draft_method(&run, &place, &[yard.spec().shape], &[], 1)?
            .write(&place.join("bundle"))?;
        println!("exported: {}", bundle.folder().display());
    }
    Ok(())
}
