//! A Zenoh session with the plug-in `ros2dds`: `interop-bridge CONFIG`, a file in JSON5.

use zenoh::{
    Result,
    internal::{plugins::PluginsManager, runtime::RuntimeBuilder},
};
use zenoh_plugin_ros2dds::ROS2Plugin;

#[tokio::main]
async fn main() -> Result<()> {
    zenoh::init_log_from_env_or("error");
    let path = std::env::args().nth(1).ok_or("the first argument is a configuration file")?;
    let config = zenoh::Config::from_file(path)?;
    let mut plugins = PluginsManager::static_plugins_only();
    plugins.declare_static_plugin::<ROS2Plugin, &str>("ros2dds", true);
    let mut runtime = RuntimeBuilder::new(config).plugins_manager(plugins).build().await?;
    runtime.start().await?;
    println!("ready");
    tokio::signal::ctrl_c().await?;
    Ok(())
}
