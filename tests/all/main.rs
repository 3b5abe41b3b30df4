//! The command line as users start it.

mod arguments;
mod bad_input;
mod compare;
mod control;
mod dependencies;
mod documentation;
mod domains;
mod endings;
mod exit_codes;
mod firmware;
mod foreign;
mod hard;
mod imports;
mod measure;
mod methods;
mod options;
mod others_in_teams;
mod output;
mod own_policies;
mod pipeline;
mod plans;
mod producers;
mod proposals;
mod published;
mod replay;
mod reproduce;
mod runs;
mod seeds;
mod serve;
#[path = "../support/mod.rs"]
mod support;
mod team;
mod terminal;
mod up;
mod verify;
mod written;
