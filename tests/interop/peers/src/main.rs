//! ROS 2 peers that share no code with zensim. Each prints JSON lines.

mod drive;
mod graph;
mod interfaces;
mod late;
mod listen;
mod peer;
mod recreate;
mod router;
mod size_estimation;
mod spawn;
mod steps;
mod talk;

use clap::{Parser, Subcommand};

#[derive(Parser)]
struct Options {
    #[command(flatten)]
    network: peer::Network,
    #[command(subcommand)]
    program: Program,
}

#[derive(Subcommand)]
enum Program {
    /// Count messages of topics, beside a subscriber without any rule.
    Listen(listen::Listen),
    /// Join late, and count what latched topics still have.
    Late(late::Late),
    /// Drive a robot.
    Drive(drive::Drive),
    /// Spawn and delete entities.
    Spawn(spawn::Spawn),
    /// Send goals to the action simulate_steps.
    Steps(steps::Steps),
    /// Print the graph, and compare its types and hashes with those of the peer.
    Graph(graph::Graph),
    /// Print when a node appears and disappears.
    Watch(graph::Watch),
    /// Publish and call a service of another peer.
    Talker(talk::Talker),
    /// Subscribe and serve.
    Listener(talk::Listener),
    /// Create, call and destroy a service client, again and again.
    Recreate(recreate::Recreate),
    /// Route, with the settings of rmw_zenohd, until stdin is closed.
    Router(router::Router),
}

#[tokio::main]
async fn main() -> hiroz::Result<()> {
    let options = Options::parse();
    let network = &options.network;
    let warnings = peer::count_warnings();
    match options.program {
        Program::Listen(program) => program.run(network),
        Program::Late(program) => program.run(network),
        Program::Drive(program) => program.run(network).await,
        Program::Spawn(program) => program.run(network, warnings).await,
        Program::Steps(program) => program.run(network).await,
        Program::Graph(program) => program.run(network),
        Program::Watch(program) => program.run(network),
        Program::Talker(program) => program.run(network).await,
        Program::Listener(program) => program.run(network),
        Program::Recreate(program) => program.run(network),
        Program::Router(program) => program.run().await,
    }
}
