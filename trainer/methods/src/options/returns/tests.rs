//! Returns beside naive lists.

use super::super::replay::NONE;
use super::*;
use crate::options::tests::{Moment, at, kept};

#[test]
fn returns_end_where_a_naive_list_says() {
    let mut moments = [Moment::default(); 12];
    (moments[4].reached, moments[4].ends_option) = (1, true);
    moments[7].changed_nothing = true;
    moments[9].ends_option = true;
    moments[11].terminated = true;
    let replay = kept(&moments);
    let rules = ReturnRules { steps: 3, discount: 0.5, no_operations: true, time_outs: true };
    let pay = |note: &Note, _| {
        let is_over = note.reached != NONE;
        Paid { reward: if is_over { 1.0 } else { 0.0 }, is_last: note.ends_option, is_over }
    };
    let next = |number, discount| Some(Next { place: at(number), discount, mask: u32::MAX });
    for (start, want) in [
        (0, Some((0.0, next(3, 0.125)))),
        (2, Some((0.25, None))),
        (4, Some((1.0, None))),
        (5, Some((0.0, next(7, 0.25)))),
        (7, Some((0.0, None))),
        (8, Some((0.0, next(10, 0.25)))),
        (10, Some((0.0, None))),
        (13, None),
    ] {
        assert_eq!(returns(&replay, at(start), rules, pay), want, "{start}");
    }
    let published = ReturnRules { no_operations: false, ..rules };
    assert_eq!(returns(&replay, at(7), published, pay), Some((0.0, next(10, 0.125))));
    // What follows the last step is not known yet.
    let short = kept(&moments[..9]);
    assert_eq!(returns(&short, at(8), published, pay), None);
}
