# The five things that people type. https://just.systems

# The shipped team, or another bundle.
run bundle="models/save-the-city":
    cargo run --release -- run {{bundle}}

# All tests, or those of one file: `just test team`.
test name="":
    cargo test {{ if name == "" { "--workspace" } else { "--test all " + name + "::" } }}

lint:
    cargo fmt --check
    cargo clippy --workspace --all-targets -- -D warnings

# What must hold before a change lands, or one stage of it.
gate *stage:
    .ci/run {{stage}}

# Writes the pages that programs write, and checks links and commands.
docs:
    SORTIE_WRITE_DOCS=1 cargo test -p sortie-methods --test all reference::
    cargo test --test all documentation::
