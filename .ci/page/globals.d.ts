// What the pages' scripts find at run time beside the browser's own.
declare const Plotly: any;
