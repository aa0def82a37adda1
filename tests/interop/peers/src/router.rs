//! A router with the settings of rmw_zenohd.

use hiroz::Result;
use hiroz::config::RouterConfigBuilder;
use serde_json::json;

use crate::peer::print;

#[derive(clap::Args)]
pub struct Router {
    /// Endpoint to listen on.
    #[arg(long)]
    listen: String,
    /// Print the settings, for zenohd, and exit.
    #[arg(long)]
    settings: bool,
}

impl Router {
    pub async fn run(self) -> Result<()> {
        let config = RouterConfigBuilder::new()
            .with_listen_endpoint(&self.listen)
            .build_config()?;
        if self.settings {
            println!("{config}");
            return Ok(());
        }
        let _session = zenoh::open(config).await?;
        print(&json!({ "ready": self.listen }));
        let mut line = String::new();
        tokio::task::spawn_blocking(move || std::io::stdin().read_line(&mut line)).await??;
        Ok(())
    }
}
