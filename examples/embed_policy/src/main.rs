//! The control loop, with a cart that is simulated: 20 steps of 0.2 seconds. Only printing needs `std`.

use std::error::Error;

use embed_policy::Controller;

const SECONDS: f32 = 0.2;
/// Metres per second squared at a force of 1.
const PUSH: f32 = 3.0;

fn main() -> Result<(), Box<dyn Error>> {
    let mut controller = Controller::new()?;
    let (mut position, mut velocity) = (1.0, 0.0);
    for step in 0..20 {
        let force = controller.force(position)?;
        println!("step {step:2}  position {position:7.4}  force {force:7.4}");
        velocity += PUSH * force * SECONDS;
        position += velocity * SECONDS;
    }
    Ok(())
}
